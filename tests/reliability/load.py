"""Open-loop load on the service: requests arrive at FACTOR times what it can do, whether or not it keeps up.

    python3 tests/reliability/load.py [--seconds 300] [--factor 4] [--binary target/release/rigsmith]

Starts the program on a port and a folder of its own, measures how long the pipeline alone takes for the load's mesh, sends
uploads of 10 kB to 100 MB (most of them small, sizes log-uniform) at a fixed rate, while a reader looks at jobs ten
times a second and a sampler reads the process's memory. Prints one table and exits with 1 when a claim fails:

- every answer is 202, 200, 429 with Retry-After, 413 or 503;
- the 99th percentile of status reads stays within 50 ms;
- every job that was taken ends `succeeded`;
- the throughput is at least 90 % of what the pipeline alone would do on the same cores.

The throughput is compared in CPU-seconds, which neither the generator nor other programs on the same cores change by much: those
of the service from the first upload to the end of the last job, for each job, beside those that `rigsmith rig` takes for the
same uploads (a spread of them), less its start. The share by the clock is printed too. Only the standard library.
"""

from __future__ import annotations

import argparse
import http.client
import json
import math
import os
import queue
import random
import re
import resource
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
SIZES = (10_000, 100_000_000)
# The exponent that makes large uploads rare: a share of about 1 in 50 is above 10 MB.
RARITY = 3.0
SENDERS = 96
READS_PER_SECOND = 10
READ_LIMIT_MS = 50.0
THROUGHPUT_SHARE = 0.9
DRAIN_SECONDS = 600
# Uploads that the pipeline alone is measured with, spread over the sizes of those that were taken.
PLAIN_RUNS = 16


def figure() -> bytes:
    """A standing figure of six boxes' worth of rings, about 1,000 vertices, as OBJ."""
    limbs = [
        ((0.0, 0.85, 0.0), (0.0, 1.4, 0.0), 0.16), ((0.0, 1.5, 0.0), (0.0, 1.75, 0.0), 0.11),
        ((0.15, 1.4, 0.0), (0.8, 1.4, 0.0), 0.06), ((-0.15, 1.4, 0.0), (-0.8, 1.4, 0.0), 0.06),
        ((0.1, 0.85, 0.0), (0.13, 0.02, 0.0), 0.09), ((-0.1, 0.85, 0.0), (-0.13, 0.02, 0.0), 0.09),
    ]  # fmt: skip
    around, rings, lines, faces = 10, 16, [], []
    for start, end, radius in limbs:
        first = len(lines)
        axis = [b - a for a, b in zip(start, end)]
        length = math.sqrt(sum(x * x for x in axis))
        axis = [x / length for x in axis]
        side = (axis[1], -axis[0], 0.0)
        for ring in range(rings):
            t = ring / (rings - 1)
            width = radius * math.sqrt(max(0.02, 1.0 - (2 * t - 1) ** 8))
            for step in range(around):
                angle = 2 * math.pi * step / around
                place = [
                    start[k] + t * length * axis[k] + width * (math.cos(angle) * side[k] + (math.sin(angle) if k == 2 else 0))
                    for k in range(3)
                ]
                lines.append("v %.5f %.5f %.5f" % tuple(place))
        for ring in range(rings - 1):
            for step in range(around):
                a = first + ring * around + step + 1
                b = first + ring * around + (step + 1) % around + 1
                faces.append(f"f {a} {b} {b + around} {a + around}")
    return "\n".join(lines + faces).encode() + b"\n"


def body(mesh: bytes, size: int, number: int) -> bytes:
    """The mesh with a comment that makes it one of its kind, and comments up to `size` bytes."""
    head = b"# upload %d\n" % number + mesh
    missing = size - len(head)
    return head + (b"#" + b"." * 98 + b"\n") * max(0, missing // 100)


def random_size(chance: random.Random) -> int:
    low, high = (math.log(size) for size in SIZES)
    return int(math.exp(low + (high - low) * chance.random() ** RARITY))


class Service:
    def __init__(self, binary: Path, folder: Path, workers: int) -> None:
        self.port = free_port()
        command = [binary, "serve", "--listen", f"127.0.0.1:{self.port}", "--data", folder, "--workers", str(workers)]
        self.process = subprocess.Popen(list(map(str, command)), cwd=ROOT, stdout=subprocess.DEVNULL, stderr=open(folder / "log.txt", "wb"))
        for _ in range(300):
            try:
                if self.request("GET", "/readyz")[0] == 200:
                    return
            except OSError:
                time.sleep(0.1)
        raise SystemExit("the service did not become ready")

    def request(self, method: str, path: str, content: bytes | None = None, headers: dict | None = None):
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=120)
        try:
            connection.request(method, path, content, headers or {})
            response = connection.getresponse()
            return response.status, dict((k.lower(), v) for k, v in response.getheaders()), response.read()
        finally:
            connection.close()

    def resident_mib(self) -> float:
        try:
            status = Path(f"/proc/{self.process.pid}/status").read_text()
        except OSError:
            return 0.0
        return int(re.search(r"VmRSS:\s+(\d+)", status)[1]) / 1024

    def cpu_seconds(self) -> float:
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def stop(self) -> None:
        self.process.send_signal(signal.SIGTERM)
        try:
            self.process.wait(60)
        except subprocess.TimeoutExpired:
            self.process.kill()


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def pipeline_seconds(binary: Path, folder: Path, mesh: bytes) -> float:
    """Time of the pipeline's stages for the mesh, least of three runs; loading the networks does not count."""
    (folder / "figure.obj").write_bytes(mesh)
    times = []
    for _ in range(3):
        command = [binary, "rig", folder / "figure.obj", "-o", folder / "out.glb", "-o", folder / "out.rig.json", "--report", folder / "report.json"]
        subprocess.run(list(map(str, command)), cwd=ROOT, check=True, capture_output=True)
        times.append(sum(json.loads((folder / "report.json").read_text())["timings_ms"].values()) / 1000)
    return min(times)


def child_cpu_seconds(command: list) -> float:
    """CPU-seconds of a program from its start to its end."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(list(map(str, command)), cwd=ROOT, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


def plain_cpu_seconds(binary: Path, folder: Path, mesh: bytes, taken: list[tuple[int, int]]) -> float:
    """Mean CPU-seconds of `rigsmith rig` for uploads like `taken` (number, size), less those of its start."""
    start = min(child_cpu_seconds([binary, "methods"]) for _ in range(3))
    by_size = sorted(taken, key=lambda upload: upload[1])
    runs = min(PLAIN_RUNS, len(by_size))
    spread = [by_size[int((run + 0.5) * len(by_size) / runs)] for run in range(runs)]
    spent = []
    for number, size in spread:
        (folder / "figure.obj").write_bytes(body(mesh, size, number))
        command = [binary, "rig", folder / "figure.obj", "-o", folder / "out.glb", "-o", folder / "out.rig.json"]
        spent.append(child_cpu_seconds(command) - start)
    return sum(spent) / len(spent)


class Load:
    def __init__(self, service: Service, mesh: bytes, rate: float, seconds: float) -> None:
        self.service, self.mesh, self.rate, self.seconds = service, mesh, rate, seconds
        self.due: queue.Queue = queue.Queue()
        self.answers: Counter = Counter()
        self.lock = threading.Lock()
        self.jobs: list[str] = []
        self.taken: list[tuple[int, int]] = []
        self.wrong: list[str] = []
        self.reads_ms: list[float] = []
        self.resident: list[float] = []
        self.sent_bytes = 0
        self.over = threading.Event()

    def run(self) -> None:
        senders = [threading.Thread(target=self.send, daemon=True) for _ in range(SENDERS)]
        others = [threading.Thread(target=work, daemon=True) for work in (self.read, self.sample)]
        for thread in senders + others:
            thread.start()
        chance = random.Random(1)
        began = time.monotonic()
        number = 0
        while (now := time.monotonic() - began) < self.seconds:
            if now * self.rate >= number:
                self.due.put((number, random_size(chance)))
                number += 1
            else:
                time.sleep(min(0.01, number / self.rate - now))
        for _ in senders:
            self.due.put(None)
        for thread in senders:
            thread.join(120)
        self.over.set()
        for thread in others:
            thread.join(5)

    def send(self) -> None:
        while (work := self.due.get()) is not None:
            number, size = work
            content = body(self.mesh, size, number)
            try:
                status, headers, answer = self.service.request("POST", "/v1/rigs?file_name=figure.obj", content, {"Content-Type": "model/obj"})
            except (ConnectionError, http.client.HTTPException):
                # Refused before the upload was read: the answer may be lost with the connection.
                status, headers, answer = 0, {}, b""
            with self.lock:
                self.answers[status] += 1
                self.sent_bytes += len(content)
                if status in (200, 202):
                    self.jobs.append(json.loads(answer)["id"])
                    self.taken.append((number, size))
                elif status == 429 and "retry-after" not in headers:
                    self.wrong.append("429 without Retry-After")
                elif status not in (0, 413, 429, 503):
                    self.wrong.append(f"{status}: {answer[:200]!r}")

    def read(self) -> None:
        chance = random.Random(2)
        while not self.over.wait(1 / READS_PER_SECOND):
            with self.lock:
                job = chance.choice(self.jobs) if self.jobs else None
            if job:
                began = time.monotonic()
                status, _, answer = self.service.request("GET", f"/v1/rigs/{job}")
                self.reads_ms.append((time.monotonic() - began) * 1000)
                if status != 200:
                    self.wrong.append(f"status read: {status}: {answer[:200]!r}")

    def sample(self) -> None:
        while not self.over.wait(0.5):
            self.resident.append(self.service.resident_mib())


def ends(service: Service, jobs: list[str]) -> tuple[Counter, float]:
    """How the jobs ended, and when the last one did."""
    states: Counter = Counter()
    deadline = time.monotonic() + DRAIN_SECONDS
    for job in jobs:
        while True:
            state = json.loads(service.request("GET", f"/v1/rigs/{job}")[2])["state"]
            if state not in ("queued", "running") or time.monotonic() > deadline:
                break
            time.sleep(0.2)
        states[state] += 1
    return states, time.monotonic()


def percentile(values: list[float], share: float) -> float:
    return sorted(values)[min(len(values) - 1, int(share * len(values)))] if values else float("nan")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=300)
    parser.add_argument("--factor", type=float, default=4)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--binary", type=Path, default=ROOT / "target/release/rigsmith")
    options = parser.parse_args()
    mesh = figure()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        alone = pipeline_seconds(options.binary, folder, mesh)
        service = Service(options.binary, folder, options.workers)
        try:
            load = Load(service, mesh, options.factor / alone, options.seconds)
            began, before = time.monotonic(), service.cpu_seconds()
            load.run()
            states, last = ends(service, load.jobs)
            spent = (service.cpu_seconds() - before) / max(1, len(load.jobs))
        finally:
            service.stop()
        plain = plain_cpu_seconds(options.binary, folder, mesh, load.taken)
    p50, p99 = percentile(load.reads_ms, 0.5), percentile(load.reads_ms, 0.99)
    share, share_by_clock = plain / spent, len(load.jobs) / (last - began) * alone
    lost = load.answers.pop(0, 0)
    print(f"pipeline alone: {alone:.2f} s per mesh; load: {options.factor / alone:.1f} uploads per second for {options.seconds:.0f} s")
    print(f"answers: {dict(sorted(load.answers.items()))}; connections closed before the answer was read: {lost}")
    print(f"uploaded: {load.sent_bytes / 1e6:.0f} MB; jobs taken: {len(load.jobs)}, ended {dict(states)}")
    print(f"status reads: {len(load.reads_ms)}, p50 {p50:.1f} ms, p99 {p99:.1f} ms")
    print(f"memory: {max(load.resident, default=0):.0f} MiB at most; {os.cpu_count()} cores, shared with this generator")
    print(f"CPU-seconds per job: {spent:.3f} in the service, {plain:.3f} in the pipeline alone")
    print(f"throughput: {share:.0%} of the pipeline alone by CPU-seconds, {share_by_clock:.0%} by the clock")
    claims = [
        (not load.wrong, f"only expected answers ({load.wrong[:3]})"),
        (p99 <= READ_LIMIT_MS, f"p99 of status reads within {READ_LIMIT_MS:.0f} ms"),
        (set(states) <= {"succeeded"}, "every job taken succeeded"),
        (share >= THROUGHPUT_SHARE, f"throughput at least {THROUGHPUT_SHARE:.0%} of the pipeline's"),
    ]
    for held, claim in claims:
        print(f"{'held' if held else 'FAILED'}: {claim}")
    failed = sum(not held for held, _ in claims)
    print(f"load: {len(claims) - failed} passed, {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
