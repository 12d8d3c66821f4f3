"""The plan past one machine: how a service of many workers fares, by a discrete simulation fed with what was measured.

    python3 tests/reliability/scale.py simulate [--workers 1000 --uploads-per-minute 10000 …]
    python3 tests/reliability/scale.py measure                # the database, with stub workers (starts PostgreSQL)

`simulate` draws arrivals (Poisson), service times (measured seconds of one thread, with the share of each mesh size) and
storage requests from a seed, runs every database transaction of every job through a server of some cores, and tells queue
waits, loads, traffic, and what is used up first. `measure` starts a server and `examples/stub_workers.rs` and counts the
statements, transactions and CPU time of a job there: figures that `simulate` has as defaults. docs/scaling.md shows both.
"""

import argparse
import collections
import heapq
import json
import math
import os
import random
import subprocess
import sys
import tempfile
from dataclasses import dataclass

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), ".."))
from postgres import Postgres  # noqa: E402
from service import cpu_s  # noqa: E402


@dataclass(frozen=True)
class Mesh:
    """A kind of upload: its share of all, the seconds of its rig on one thread, and the bytes that travel."""

    share: float
    seconds: float
    upload_bytes: int
    result_bytes: int


# docs/performance.md: seconds of all threads together; bytes as measured of such files and their GLB, rig.json and preview.
MESHES = (
    Mesh(0.30, 0.31, 60_000, 250_000),
    Mesh(0.40, 0.63, 150_000, 600_000),
    Mesh(0.20, 1.46, 1_500_000, 3_000_000),
    Mesh(0.10, 1.82, 10_000_000, 18_000_000),
)


@dataclass(frozen=True)
class Plan:
    workers: int = 1000
    # Workers of one process: they share its connections, and its polling.
    together: int = 8
    uploads_per_minute: float = 10_000
    # How much slower than measured a worker is: busy cores, other processors.
    slowdown: float = 2.0
    # The database: cores, and CPU-milliseconds of each transaction: what `measure` saw for a job, by their statements.
    database_cores: int = 8
    submit_ms: float = 6.7
    claim_ms: float = 3.9
    advance_ms: float = 1.8
    extend_ms: float = 1.1
    finish_ms: float = 4.3
    look_ms: float = 0.36
    # Time of a flush to the disk, and the transactions that share one when many commit.
    flush_ms: float = 1.0
    flushed_together: int = 8
    # Storage: time of a request, and bytes a second of one transfer.
    storage_ms: float = 30.0
    storage_bytes_per_second: float = 50e6
    # Progress is told four times a second at most, and leases are extended every three seconds.
    advance_every_s: float = 0.25
    advances_max: int = 6
    extend_every_s: float = 3.0
    # News are gathered for this long; a process looks by itself every `look_s`, and for news every `rest_s`.
    gather_s: float = 0.02
    look_s: float = 5.0
    rest_s: float = 0.2
    seconds: float = 120.0
    seed: int = 1


class Database:
    """`cores` servers and one queue. Gives the time at which a transaction is done."""

    def __init__(self, cores):
        self.free = [0.0] * cores
        self.busy_s, self.transactions, self.waited_s = 0.0, 0, 0.0

    def run(self, now, cpu_s):
        began = max(now, self.free[0])
        heapq.heapreplace(self.free, began + cpu_s)
        self.busy_s += cpu_s
        self.transactions += 1
        self.waited_s += began - now
        return began + cpu_s


def share(values, part):
    values = sorted(values)
    return values[min(len(values) - 1, int(part * len(values)))] if values else 0.0


def simulate(plan, meshes=MESHES):
    """Runs the plan. Times are seconds."""
    dice = random.Random(plan.seed)
    database = Database(plan.database_cores)
    flush_s = plan.flush_ms / 1000
    processes = math.ceil(plan.workers / plan.together)
    events, order = [], 0

    def at(time, kind, what):
        nonlocal order
        order += 1
        heapq.heappush(events, (time, order, kind, what))

    rate = plan.uploads_per_minute / 60
    moment = dice.expovariate(rate)
    while moment < plan.seconds:
        at(moment, "upload", dice.choices(meshes, [mesh.share for mesh in meshes])[0])
        moment += dice.expovariate(rate)
    waiting, idle = collections.deque(), plan.workers
    waits, busy_s, moved_in, moved_out, requests, done, depth_max = [], 0.0, 0, 0, 0, 0, 0
    looks_in_all = 0.0
    # Polling and news of idle processes are a steady load; it is charged once a second.
    for second in range(int(plan.seconds)):
        at(float(second), "looks", None)

    def begin(now):
        """An idle worker takes the first job that waits."""
        nonlocal idle
        idle -= 1
        mesh, queued_at = waiting.popleft()
        at(database.run(now, plan.claim_ms / 1000) + flush_s, "work", (mesh, queued_at))

    while events:
        now, _, kind, what = heapq.heappop(events)
        if kind == "upload":
            moved_in += what.upload_bytes
            requests += 1
            stored = plan.storage_ms / 1000 + what.upload_bytes / plan.storage_bytes_per_second
            at(now + stored, "submit", what)
        elif kind == "submit":
            at(database.run(now, plan.submit_ms / 1000) + flush_s, "queued", what)
        elif kind == "queued":
            # Somebody who is idle hears of it; when all work, the first who is done takes it.
            waiting.append((what, now))
            depth_max = max(depth_max, len(waiting))
            if idle > 0:
                idle_processes = max(1, min(processes, idle))
                heard_s = plan.gather_s * dice.random() + plan.rest_s / idle_processes * dice.random()
                at(now + heard_s, "heard", None)
        elif kind == "heard":
            if waiting and idle > 0:
                begin(now)
        elif kind == "work":
            mesh, queued_at = what
            waits.append(now - queued_at)
            moved_out += mesh.upload_bytes
            moved_in += mesh.result_bytes
            # Reads the upload; writes GLB, rig.json and preview.
            requests += 4
            storage_s = 4 * plan.storage_ms / 1000 + (mesh.upload_bytes + mesh.result_bytes) / plan.storage_bytes_per_second
            seconds = mesh.seconds * plan.slowdown + storage_s
            for step in range(1, min(plan.advances_max, int(seconds / plan.advance_every_s) + 1)):
                at(now + seconds * step / plan.advances_max, "write", plan.advance_ms)
            for beat in range(1, int(seconds / plan.extend_every_s) + 1):
                at(now + beat * plan.extend_every_s, "write", plan.extend_ms)
            at(now + seconds, "finish", (mesh, seconds))
        elif kind == "write":
            database.run(now, what / 1000)
        elif kind == "finish":
            mesh, seconds = what
            ended = database.run(now, plan.finish_ms / 1000) + flush_s
            busy_s += seconds
            done += 1
            # The caller fetches what was made.
            moved_out += mesh.result_bytes
            requests += 3
            at(ended, "free", None)
        elif kind == "free":
            idle += 1
            if waiting:
                begin(now)
        elif kind == "looks":
            idle_processes = min(processes, idle)
            looks = idle / plan.look_s + idle_processes * min(1 / plan.rest_s, rate)
            looks_in_all += looks
            database.busy_s += looks * plan.look_ms / 1000
    loads = {
        "workers": busy_s / (plan.workers * plan.seconds),
        "database cores": database.busy_s / (plan.database_cores * plan.seconds),
        "database flushes": database.transactions / plan.seconds * flush_s / plan.flushed_together,
    }
    return {
        "jobs": done,
        "wait_s": {"p50": share(waits, 0.5), "p95": share(waits, 0.95), "p99": share(waits, 0.99), "max": max(waits)},
        "waiting_max": depth_max,
        "load": loads,
        "used_up_first": max(loads, key=loads.get),
        "transactions_per_second": (database.transactions + looks_in_all) / plan.seconds,
        "database_wait_ms": 1000 * database.waited_s / database.transactions,
        "connections": processes * 10,
        "storage_requests_per_second": requests / plan.seconds,
        "storage_in_mb_per_second": moved_in / plan.seconds / 1e6,
        "storage_out_mb_per_second": moved_out / plan.seconds / 1e6,
    }


SETTINGS = {"shared_preload_libraries": "pg_stat_statements", "pg_stat_statements.max": "1000", "max_connections": "300"}


def measure(arguments):
    folder = tempfile.mkdtemp(prefix="rigsmith-scale-")
    server = Postgres(folder, SETTINGS).start()
    try:
        server.query("CREATE EXTENSION pg_stat_statements")
        for waiting in arguments.waiting:
            server.query("DROP DATABASE IF EXISTS stub WITH (FORCE)")
            server.query("CREATE DATABASE stub")
            server.query("SELECT pg_stat_statements_reset()")
            url = server.url.rsplit("/", 1)[0] + "/stub"
            stub = [arguments.stub, url, arguments.workers, arguments.jobs, waiting, arguments.callers]
            process = subprocess.Popen([str(part) for part in stub], stdout=subprocess.PIPE, text=True)
            used_s = 0
            while process.poll() is None:
                try:
                    process.wait(timeout=1)
                except subprocess.TimeoutExpired:
                    # Connections take their figures with them, so the last look counts.
                    used_s = max(used_s, cpu_s(server.process.pid))
            figures = json.loads(process.stdout.read())
            jobs = figures["jobs"]
            calls = server.query(
                "SELECT calls, round(total_exec_time::numeric, 1), left(regexp_replace(query, '\\s+', ' ', 'g'), 90) "
                "FROM pg_stat_statements JOIN pg_database d ON d.oid = dbid WHERE datname = 'stub' ORDER BY 2 DESC")
            rows = [row.split("|", 2) for row in calls.splitlines()]
            figures |= {
                "statements_per_job": sum(int(row[0]) for row in rows) / jobs,
                "execution_ms_per_job": sum(float(row[1]) for row in rows) / jobs,
                "server_cpu_ms_per_job": 1000 * used_s / jobs,
                "slowest": [f"{int(row[0]) / jobs:.2f} × {float(row[1]) / int(row[0]):.3f} ms  {row[2]}" for row in rows[:8]],
            }
            print(json.dumps(figures, indent=2, ensure_ascii=False), flush=True)
    finally:
        server.stop()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    simulation = commands.add_parser("simulate")
    for name, default in Plan().__dict__.items():
        simulation.add_argument("--" + name.replace("_", "-"), type=type(default), default=default)
    measurement = commands.add_parser("measure")
    measurement.add_argument("--stub", default="target/release/examples/stub_workers")
    measurement.add_argument("--workers", type=int, default=64)
    measurement.add_argument("--jobs", type=int, default=2000)
    measurement.add_argument("--callers", type=int, default=20)
    measurement.add_argument("--waiting", type=int, nargs="+", default=[100, 1000])
    arguments = parser.parse_args()
    if arguments.command == "measure":
        measure(arguments)
    else:
        plan = Plan(**{name: getattr(arguments, name) for name in Plan().__dict__})
        print(json.dumps(simulate(plan), indent=2))


if __name__ == "__main__":
    main()
