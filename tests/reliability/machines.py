"""Nothing is lost between machines: doors and workers on one database and one bucket, while all of them fail.

Several `rigsmith serve --workers 0` and `rigsmith worker` share a PostgreSQL server (tests/postgres.py) and the S3
stand-in (examples/s3_stand_in.rs). Clients send every request with an idempotency key, to any door, and repeat it until it
is answered. Meanwhile processes are killed (SIGKILL), stopped for up to twice a lease (SIGSTOP, SIGCONT) or asked to end
(SIGTERM) at random moments and started again; the database crashes and comes back; and for a while the storage answers
with 500 and cuts connections. Afterwards:

- every accepted job is there and ended once, `succeeded` or honestly `failed` with `worker_lost`;
- no request made two jobs, and the events of each job are numbered without gaps;
- every artifact, fetched through the doors, and every blob, read from the bucket, has the bytes that its digest says;
- nothing is named that is not there.

    cargo build --release --bins --examples
    python3 tests/reliability/machines.py --jobs 300 --faults 50
"""

import argparse
import collections
import hashlib
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), ".."))
from kills import check_artifacts, wait_for_all  # noqa: E402
from postgres import Postgres  # noqa: E402
from service import REPOSITORY, Service, figure, free_port  # noqa: E402

KEY_ID = "stand-in"
LEASE_S = 15


class Bucket:
    """The S3 stand-in."""

    def __init__(self, program, log):
        self.port = free_port()
        with open(log, "ab") as output:
            self.process = subprocess.Popen([program, f"127.0.0.1:{self.port}"], stdout=output, stderr=output)
        self.url = f"s3://rigs/all?endpoint=http://127.0.0.1:{self.port}"
        until = time.monotonic() + 30
        while time.monotonic() < until:
            try:
                self.counts()
                return
            except OSError:
                time.sleep(0.05)
        raise RuntimeError("the stand-in did not start")

    def request(self, method, path):
        headers = {"Authorization": f"AWS4-HMAC-SHA256 Credential={KEY_ID}/"}
        request = urllib.request.Request(f"http://127.0.0.1:{self.port}{path}", method=method, headers=headers)
        with urllib.request.urlopen(request, timeout=30) as answer:
            return answer.read()

    def faults(self, errors, cuts):
        self.request("PUT", f"/-/faults?errors={errors}&cuts={cuts}")

    def counts(self):
        return json.loads(self.request("GET", "/-/counts"))

    def names(self):
        names, after = set(), ""
        while after is not None:
            token = f"&continuation-token={after}" if after else ""
            text = self.request("GET", f"/rigs?list-type=2&prefix=all/{token}").decode()
            names.update(re.findall(r"<Key>all/([^<]*)</Key>", text))
            more = re.search(r"<NextContinuationToken>([^<]*)<", text)
            after = more.group(1) if more else None
        return names


class Node(Service):
    """A door or a worker. Its probes are where its metrics are."""

    def __init__(self, binary, name, folder, arguments, has_door):
        super().__init__(binary, os.path.join(folder, name), os.path.join(folder, f"{name}.log"), arguments)
        self.name, self.has_door, self.probes = name, has_door, free_port()
        self.at_work = threading.Lock()

    def start(self, wait_s=180):
        """Starts it, again and again while the database or the storage is away."""
        environment = dict(os.environ, AWS_ACCESS_KEY_ID=KEY_ID, AWS_SECRET_ACCESS_KEY="secret")
        environment.setdefault("ORT_DYLIB_PATH", os.path.join(REPOSITORY, "third_party/onnxruntime/libonnxruntime.so"))
        environment.setdefault("RIGSMITH_MODELS", os.path.join(REPOSITORY, "models/artifacts"))
        door = ["serve", "--workers", "0", "--listen", f"127.0.0.1:{self.port}"] if self.has_door else ["worker"]
        command = [self.binary, *door, "--data", self.data, "--metrics-listen", f"127.0.0.1:{self.probes}", *self.arguments]
        until = time.monotonic() + wait_s
        self.process = None
        while time.monotonic() < until:
            if self.process is None or self.process.poll() is not None:
                with open(self.log, "ab") as log:
                    self.process = subprocess.Popen(command, stdout=log, stderr=log, env=environment)
            try:
                with urllib.request.urlopen(f"http://127.0.0.1:{self.probes}/readyz", timeout=5) as answer:
                    if answer.status == 200:
                        return self
            except OSError:
                pass
            time.sleep(0.1)
        raise RuntimeError(f"{self.name} was not ready after {wait_s} s; see {self.log}")


class Doors:
    """Clients that send each request to any door until one answers."""

    def __init__(self, doors, jobs, seconds, seed, threads=4):
        self.doors, self.jobs, self.pause_s = doors, jobs, seconds / max(jobs, 1) * threads
        self.random, self.lock = random.Random(seed), threading.Lock()
        self.next, self.accepted, self.unanswered, self.refused = 0, {}, 0, collections.Counter()
        self.threads = [threading.Thread(target=self.run, daemon=True) for _ in range(threads)]

    def run(self):
        while True:
            with self.lock:
                number, pause_s = self.next, self.random.uniform(0, 2) * self.pause_s
                if number >= self.jobs:
                    return
                self.next += 1
            self.submit(number)
            time.sleep(pause_s)

    def submit(self, number):
        mesh = figure(1 + number / 1000)
        while True:
            with self.lock:
                door = self.random.choice(self.doors)
            try:
                status, _, body = door.rig(mesh, key=f"request-{number}")
            except OSError:
                with self.lock:
                    self.unanswered += 1
                time.sleep(0.3)
                continue
            if status in (200, 202):
                with self.lock:
                    self.accepted[number] = json.loads(body)["id"]
                return
            with self.lock:
                self.refused[f"{status} {json.loads(body)['code']}"] += 1
            if status not in (429, 503):
                raise RuntimeError(f"request {number}: {status} {body[:300]}")
            time.sleep(1)


def strike(node, how, pause_s):
    """One fault of one process, and its return."""
    with node.at_work:
        if how == "stopped":
            node.signal(signal.SIGSTOP)
            time.sleep(pause_s)
            node.signal(signal.SIGCONT)
        elif how == "killed":
            node.kill()
            node.start()
        else:
            assert node.stop() == 0, f"{node.name} ended badly"
            node.start()


def trouble(arguments, nodes, database, bucket):
    """All faults, spread over `arguments.seconds`. Gives how often each came."""
    moments = random.Random(arguments.seed)
    plan = [(moments.uniform(0, arguments.seconds), "process") for _ in range(arguments.faults)]
    plan += [(arguments.seconds * (index + 0.7) / arguments.restarts, "database") for index in range(arguments.restarts)]
    plan += [(arguments.seconds * 0.4, "storage"), (arguments.seconds * 0.4 + arguments.storage_s, "storage again")]
    began, came, strikes = time.monotonic(), collections.Counter(), []
    for moment, what in sorted(plan):
        time.sleep(max(0, moment - (time.monotonic() - began)))
        if what == "process":
            node, how = moments.choice(nodes), moments.choices(("killed", "stopped", "ended"), (5, 3, 2))[0]
            came[how] += 1
            thread = threading.Thread(target=strike, args=(node, how, moments.uniform(1, 2 * LEASE_S)))
            thread.start()
            strikes.append(thread)
        elif what == "database":
            came["database restarts"] += 1
            database.stop(signal.SIGQUIT if came["database restarts"] % 2 else signal.SIGINT)
            time.sleep(moments.uniform(0.5, 4))
            database.start()
        else:
            bucket.faults(*((0.35, 0.35) if what == "storage" else (0, 0)))
        print(f"{time.monotonic() - began:5.0f} s  {what}: {dict(came)}", flush=True)
    for thread in strikes:
        thread.join()
    return came


def check_database(database, jobs):
    """What no client can see."""
    rows = database.query("SELECT count(*), sum((n = 1)::int) FROM (SELECT count(*) AS n FROM events "
                          "WHERE body::json->>'event' = 'done' GROUP BY job) ends")
    assert rows == f"{len(jobs)}|{len(jobs)}", f"every job ends once: {rows}"
    assert int(database.query("SELECT count(*) FROM jobs")) == len(jobs), "one job for each request"
    gaps = database.query("SELECT count(*) FROM (SELECT job FROM events GROUP BY job HAVING count(*) <> max(sequence)) g")
    assert gaps == "0", f"{gaps} jobs whose events have gaps"
    attempts = dict(row.split("|") for row in
                    database.query("SELECT attempt, count(*) FROM jobs GROUP BY 1 ORDER BY 1").splitlines())
    blobs = [row.split("|") for row in
             database.query("SELECT location, encode(sha256, 'hex'), bytes FROM blobs").splitlines()]
    return {int(attempt): int(count) for attempt, count in attempts.items()}, blobs


def check_bucket(bucket, blobs):
    for location, sha256, size in blobs:
        content = bucket.request("GET", f"/rigs/all/{location}")
        assert (hashlib.sha256(content).hexdigest(), len(content)) == (sha256, int(size)), location
    return len(bucket.names() - {location for location, _, _ in blobs})


def said(nodes, words):
    count = 0
    for node in nodes:
        with open(node.log, encoding="utf-8", errors="replace") as log:
            count += sum(words in line for line in log)
    return count


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binary", default="target/release/rigsmith")
    parser.add_argument("--stand-in", default="target/release/examples/s3_stand_in")
    parser.add_argument("--doors", type=int, default=2)
    parser.add_argument("--workers", type=int, default=3)
    parser.add_argument("--jobs", type=int, default=300)
    parser.add_argument("--faults", type=int, default=50, help="of processes")
    parser.add_argument("--restarts", type=int, default=5, help="of the database; every other one is a crash")
    parser.add_argument("--storage-s", type=float, default=60, help="how long the storage fails")
    parser.add_argument("--seconds", type=float, default=600, help="over which all of this is spread")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--wait-s", type=int, default=3600)
    arguments = parser.parse_args()
    folder = tempfile.mkdtemp(prefix="rigsmith-machines-")
    os.chmod(folder, 0o711)
    os.mkdir(os.path.join(folder, "database"))
    database = bucket = None
    nodes = []
    try:
        database = Postgres(os.path.join(folder, "database")).start()
        bucket = Bucket(arguments.stand_in, os.path.join(folder, "bucket.log"))
        shared = ["--database", database.url, "--storage", bucket.url, "--log", "warn", "--threads", "1"]
        doors = [Node(arguments.binary, f"door-{number}", folder, [*shared, "--queue", "100000"], True)
                 for number in range(arguments.doors)]
        workers = [Node(arguments.binary, f"worker-{number}", folder, shared, False) for number in range(arguments.workers)]
        nodes = doors + workers
        for node in nodes:
            node.start()
        clients = Doors(doors, arguments.jobs, arguments.seconds * 0.8, arguments.seed)
        began = time.monotonic()
        for thread in clients.threads:
            thread.start()
        came = trouble(arguments, nodes, database, bucket)
        for thread in clients.threads:
            thread.join()
        assert len(clients.accepted) == arguments.jobs, "every request was answered in the end"
        assert len(set(clients.accepted.values())) == arguments.jobs, "every request has a job of its own"
        jobs = wait_for_all(doors[0], clients.accepted, arguments.wait_s)
        ended = collections.Counter(
            job["state"] if job["state"] != "failed" else f"failed: {job['error']['code']}" for job in jobs.values())
        assert set(ended) <= {"succeeded", "failed: worker_lost"}, ended
        artifacts = check_artifacts(doors[-1], jobs)
        for node in nodes:
            assert node.stop() == 0, node.name
        attempts, blobs = check_database(database, jobs)
        orphans = check_bucket(bucket, blobs)
        print(json.dumps({
            "jobs": len(jobs), "faults": dict(came), "storage_failed_s": arguments.storage_s, "ended": dict(ended),
            "attempts": attempts, "requests_repeated": clients.unanswered, "requests_refused": dict(clients.refused),
            "artifacts_intact": artifacts, "blobs_intact": len(blobs), "objects_without_a_name": orphans,
            "late_attempts_stopped": said(workers, "a late attempt stops"),
            "late_results_refused": said(workers, "a late result was refused"),
            "jobs_given_back_for_storage": said(workers, "the storage does not answer; the job goes back"),
            "seconds": round(time.monotonic() - began),
        }, indent=2))
    except BaseException:
        print(f"what happened is in {folder}", file=sys.stderr)
        raise
    else:
        shutil.rmtree(folder, ignore_errors=True)
    finally:
        for node in nodes:
            if node.process and node.process.poll() is None:
                node.signal(signal.SIGCONT)
                node.kill()
        if bucket:
            bucket.process.kill()
        if database:
            database.stop(signal.SIGQUIT)


if __name__ == "__main__":
    main()
