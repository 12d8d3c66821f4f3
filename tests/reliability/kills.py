"""Nothing is lost: jobs in flight, the process killed at random moments while clients keep submitting.

Clients send every request with an idempotency key and repeat it until it is answered. When all accepted jobs are over,
three things are checked: every accepted job is there and ended `succeeded` or honestly `failed`; none ended twice, and
no request made two jobs (the job database is read for that); every artifact and every blob has the bytes that its digest says,
and no blob is there that nothing names.
"""

import argparse
import collections
import hashlib
import json
import os
import random
import shutil
import sqlite3
import tempfile
import threading
import time

from service import FINAL, Service, figure


class Clients:
    """Threads that send `jobs` requests at once, and then one every `pause_s` or so until they are told to stop."""

    def __init__(self, service, jobs, pause_s, seed, threads=4):
        self.service, self.jobs, self.pause_s, self.random = service, jobs, pause_s, random.Random(seed)
        self.lock, self.stopped = threading.Lock(), threading.Event()
        self.next, self.accepted, self.unanswered, self.refused = 0, {}, 0, collections.Counter()
        self.threads = [threading.Thread(target=self.run, daemon=True) for _ in range(threads)]

    def start(self):
        for thread in self.threads:
            thread.start()

    def stop(self):
        self.stopped.set()
        for thread in self.threads:
            thread.join()

    def run(self):
        while True:
            with self.lock:
                number, later = self.next, self.next >= self.jobs
                pause_s = self.random.uniform(0, 2) * self.pause_s * len(self.threads)
                if later and self.stopped.is_set():
                    return
                self.next += 1
            if later:
                self.stopped.wait(pause_s)
            self.submit(number)

    def submit(self, number):
        mesh = figure(1 + number / 1000)
        while True:
            try:
                status, _, body = self.service.rig(mesh, key=f"request-{number}")
            except OSError:
                with self.lock:
                    self.unanswered += 1
                time.sleep(0.2)
                continue
            if status in (200, 202):
                with self.lock:
                    self.accepted[number] = json.loads(body)["id"]
                return
            with self.lock:
                self.refused[status] += 1
            if status not in (429, 503):
                raise RuntimeError(f"request {number}: {status} {body[:300]}")
            time.sleep(0.5)


def kill_and_restart(service, clients, kills, seed):
    """Kills at random moments; gives the seconds from start to ready."""
    moments, ready = random.Random(seed), []
    for kill in range(kills):
        time.sleep(moments.uniform(0.05, 6))
        service.kill()
        began = time.monotonic()
        service.start()
        ready.append(time.monotonic() - began)
        print(f"kill {kill + 1} of {kills}: {len(clients.accepted)} accepted, ready in {ready[-1]:.1f} s", flush=True)
    return ready


def wait_for_all(service, accepted, wait_s):
    until = time.monotonic() + wait_s
    jobs = {}
    while time.monotonic() < until:
        for number, job_id in accepted.items():
            if number not in jobs:
                job = service.json(f"/v1/rigs/{job_id}")
                if job["state"] in FINAL:
                    jobs[number] = job
        if len(jobs) == len(accepted):
            return jobs
        time.sleep(1)
    raise SystemExit(f"{len(accepted) - len(jobs)} jobs are not over after {wait_s} s")


def check_artifacts(service, jobs):
    checked = 0
    for job in jobs.values():
        for artifact in (job["result"] or {}).get("artifacts", []):
            status, _, content = service.request("GET", artifact["url"])
            assert status == 200, (artifact["url"], status)
            assert hashlib.sha256(content).hexdigest() == artifact["sha256"], artifact["url"]
            assert len(content) == artifact["bytes"]
            checked += 1
    return checked


def check_database(data, jobs):
    """What no client can see: ends per job, jobs per key, files on the disk."""
    database = sqlite3.connect(f"file:{os.path.join(data, 'jobs.db')}?mode=ro", uri=True)
    ends = dict(database.execute(
        "SELECT job, count(*) FROM events WHERE json_extract(body, '$.event') = 'done' GROUP BY job"))
    assert len(ends) == len(jobs) and set(ends.values()) == {1}, "every job ends once"
    (count,) = database.execute("SELECT count(*) FROM jobs").fetchone()
    assert count == len(jobs), f"{count} jobs for {len(jobs)} requests"
    (gaps,) = database.execute(
        "SELECT count(*) FROM (SELECT job FROM events GROUP BY job HAVING count(*) <> max(sequence))").fetchone()
    assert gaps == 0, "events are numbered without gaps"
    named = {location: (bytes(sha256).hex(), size) for location, sha256, size in
             database.execute("SELECT location, sha256, bytes FROM blobs")}
    there = {f"blobs/{name}" for name in os.listdir(os.path.join(data, "blobs"))}
    assert there == set(named), f"{len(there - set(named))} files without a name, {len(set(named) - there)} names without a file"
    for location, (sha256, size) in named.items():
        with open(os.path.join(data, location), "rb") as file:
            content = file.read()
        assert (hashlib.sha256(content).hexdigest(), len(content)) == (sha256, size), location
    assert os.listdir(os.path.join(data, "incoming")) == []
    attempts = collections.Counter(row[0] for row in database.execute("SELECT attempt FROM jobs"))
    return len(named), dict(sorted(attempts.items()))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binary", default="target/release/rigsmith")
    parser.add_argument("--jobs", type=int, default=200, help="sent at once, before the first kill")
    parser.add_argument("--pause-s", type=float, default=5, help="mean time between the requests that follow")
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--wait-s", type=int, default=3600)
    arguments = parser.parse_args()
    data = tempfile.mkdtemp(prefix="rigsmith-kills-")
    options = ["--queue", str(10 * arguments.jobs), "--workers", str(arguments.workers), "--log", "warn"]
    service = Service(arguments.binary, os.path.join(data, "data"), os.path.join(data, "log"), options).start()
    clients = Clients(service, arguments.jobs, arguments.pause_s, arguments.seed)
    began = time.monotonic()
    clients.start()
    ready = kill_and_restart(service, clients, arguments.kills, arguments.seed)
    clients.stop()
    assert len(clients.accepted) == clients.next, "every request was answered in the end"
    assert len(set(clients.accepted.values())) == clients.next, "every request has a job of its own"
    jobs = wait_for_all(service, clients.accepted, arguments.wait_s)
    ended = collections.Counter(
        job["state"] if job["state"] != "failed" else f"failed: {job['error']['code']}" for job in jobs.values())
    assert set(ended) <= {"succeeded", "failed: worker_lost"}, ended
    artifacts = check_artifacts(service, jobs)
    assert service.stop() == 0
    blobs, attempts = check_database(os.path.join(data, "data"), jobs)
    print(json.dumps({
        "jobs": len(jobs), "kills": arguments.kills, "ended": dict(ended), "attempts": attempts,
        "requests_repeated": clients.unanswered, "requests_refused": dict(clients.refused),
        "artifacts_intact": artifacts, "blobs_intact": blobs,
        "ready_s": {"median": sorted(ready)[len(ready) // 2], "max": max(ready)} if ready else {},
        "seconds": round(time.monotonic() - began),
    }, indent=2))
    shutil.rmtree(data)


if __name__ == "__main__":
    main()
