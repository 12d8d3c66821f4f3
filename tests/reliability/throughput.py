"""Throughput of 1, 2 and 4 worker processes of one thread each: where it stops scaling, and whether the queue is why.

One door, a database, the S3 stand-in, and more jobs than workers. For each number of workers: jobs a second; CPU-seconds
of a job, which others on the machine do not change; how many cores the workers got, and how many others took meanwhile;
the share of the time in which workers had a job in hand; and what the database used for each job.

    cargo build --release --bins --examples
    python3 tests/reliability/throughput.py
"""

import argparse
import json
import os
import shutil
import signal
import tempfile
import time
from datetime import datetime

from machines import Bucket, Doors, Node, Postgres
from kills import wait_for_all
from service import TICKS, cpu_s

def machine_cpu_s():
    with open("/proc/stat", encoding="ascii") as stat:
        user, nice, system, *_ = map(int, stat.readline().split()[1:])
    return (user + nice + system) / TICKS


def seconds(job):
    moments = [datetime.fromisoformat(job[name].replace("Z", "+00:00")) for name in ("started_at", "finished_at")]
    return (moments[1] - moments[0]).total_seconds()


def measure(arguments, count, folder):
    os.mkdir(folder)
    os.chmod(folder, 0o711)
    os.mkdir(os.path.join(folder, "database"))
    database = Postgres(os.path.join(folder, "database")).start()
    bucket = Bucket(arguments.stand_in, os.path.join(folder, "bucket.log"))
    shared = ["--database", database.url, "--storage", bucket.url, "--log", "warn", "--threads", "1"]
    door = Node(arguments.binary, "door", folder, [*shared, "--queue", "100000"], True)
    workers = [Node(arguments.binary, f"worker-{number}", folder, shared, False) for number in range(count)]
    try:
        door.start()
        clients = Doors([door], arguments.jobs, 0, arguments.seed)
        for thread in clients.threads:
            thread.start()
        for thread in clients.threads:
            thread.join()
        for worker in workers:
            worker.start()
            # The first one waits for the others, so that all begin together.
            worker.signal(signal.SIGSTOP)
        pids = [worker.process.pid for worker in workers]
        before = cpu_s(*pids), cpu_s(database.process.pid), machine_cpu_s()
        done = int(database.query("SELECT count(*) FROM jobs WHERE finished_at IS NOT NULL"))
        began = time.monotonic()
        for worker in workers:
            worker.signal(signal.SIGCONT)
        while int(database.query("SELECT count(*) FROM jobs WHERE finished_at IS NULL")):
            time.sleep(0.5)
        took = time.monotonic() - began
        used = [after - start for start, after in zip(before, (cpu_s(*pids), cpu_s(database.process.pid), machine_cpu_s()))]
        jobs = wait_for_all(door, clients.accepted, 60)
        assert all(job["state"] == "succeeded" for job in jobs.values())
        counted = arguments.jobs - done
        return {
            "workers": count, "jobs": counted, "seconds": round(took, 1),
            "jobs_per_second": round(counted / took, 2),
            "worker_cpu_s_per_job": round(used[0] / counted, 3),
            "cores_of_the_workers": round(used[0] / took, 2),
            "cores_of_all_else": round((used[2] - used[0]) / took, 2),
            "database_cpu_ms_per_job": round(1000 * used[1] / counted, 1),
            "share_of_time_with_a_job": round(sum(map(seconds, jobs.values())) / (count * took) * counted / len(jobs), 3),
        }
    finally:
        for node in [door, *workers]:
            if node.process and node.process.poll() is None:
                node.signal(signal.SIGCONT)
                node.kill()
        bucket.process.kill()
        database.stop(signal.SIGQUIT)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binary", default="target/release/rigsmith")
    parser.add_argument("--stand-in", default="target/release/examples/s3_stand_in")
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2, 4])
    parser.add_argument("--jobs", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    folder = tempfile.mkdtemp(prefix="rigsmith-throughput-")
    os.chmod(folder, 0o711)
    for count in arguments.workers:
        print(json.dumps(measure(arguments, count, os.path.join(folder, str(count)))), flush=True)
    shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    main()
