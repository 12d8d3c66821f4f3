"""What the reliability scripts share: the service as a process, requests, and meshes that cost about a second.

Only the standard library is used, so that anyone with the release binary can run them:

    cargo build --release
    python3 tests/reliability/kills.py --binary target/release/rigsmith
    python3 tests/reliability/faults.py --binary target/release/rigsmith
"""

import http.client
import json
import os
import signal
import socket
import subprocess
import time
import urllib.parse

REPOSITORY = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
FINAL = ("succeeded", "failed", "canceled", "expired")
TICKS = os.sysconf("SC_CLK_TCK")


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Service:
    """`rigsmith serve` on one data folder; may be killed and started again."""

    started = []

    def __init__(self, binary, data, log, arguments=()):
        self.binary, self.data, self.log, self.arguments = binary, data, log, list(arguments)
        self.port = free_port()
        self.process = None

    def start(self, wait_s=180):
        environment = dict(os.environ)
        environment.setdefault("ORT_DYLIB_PATH", os.path.join(REPOSITORY, "third_party/onnxruntime/libonnxruntime.so"))
        environment.setdefault("RIGSMITH_MODELS", os.path.join(REPOSITORY, "models/artifacts"))
        command = [self.binary, "serve", "--listen", f"127.0.0.1:{self.port}", "--data", self.data, *self.arguments]
        with open(self.log, "ab") as log:
            self.process = subprocess.Popen(command, stdout=log, stderr=log, env=environment)
        Service.started.append(self)
        until = time.monotonic() + wait_s
        while time.monotonic() < until:
            if self.process.poll() is not None:
                raise RuntimeError(f"the service ended with {self.process.returncode}; see {self.log}")
            try:
                if self.request("GET", "/readyz")[0] == 200:
                    return self
            except OSError:
                pass
            time.sleep(0.05)
        raise RuntimeError(f"the service was not ready after {wait_s} s; see {self.log}")

    def signal(self, number):
        self.process.send_signal(number)

    def kill(self):
        self.signal(signal.SIGKILL)
        self.process.wait()

    def stop(self):
        self.signal(signal.SIGTERM)
        return self.process.wait()

    def request(self, method, path, body=None, headers=(), timeout_s=30):
        """Status, headers (lower case) and bytes of one request. Raises OSError when there is no answer."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=timeout_s)
        try:
            connection.request(method, path, body=body, headers=dict(headers))
            answer = connection.getresponse()
            return answer.status, {name.lower(): value for name, value in answer.getheaders()}, answer.read()
        except http.client.HTTPException as error:
            raise OSError(str(error)) from error
        finally:
            connection.close()

    def json(self, path):
        status, _, body = self.request("GET", path)
        if status != 200:
            raise RuntimeError(f"{path}: {status} {body[:300]}")
        return json.loads(body)

    def rig(self, mesh, key=None, query="", name="figure.obj"):
        headers = {"Content-Type": "application/octet-stream"}
        if key:
            headers["Idempotency-Key"] = key
        parameters = f"file_name={urllib.parse.quote(name)}" + (f"&{query}" if query else "")
        return self.request("POST", f"/v1/rigs?{parameters}", body=mesh, headers=headers)

    def until_over(self, path, wait_s):
        """The job at `path` when it is over, and how long that took."""
        began = time.monotonic()
        while time.monotonic() - began < wait_s:
            job = self.json(path)
            if job["state"] in FINAL:
                return job, time.monotonic() - began
            time.sleep(0.2)
        raise RuntimeError(f"{path} is not over after {wait_s} s")


def cpu_s(*pids):
    """CPU time of processes and of the children that they have now."""
    total = 0
    wanted = set(pids)
    for entry in os.listdir("/proc"):
        if entry.isdigit():
            try:
                with open(f"/proc/{entry}/stat", encoding="ascii", errors="replace") as stat:
                    fields = stat.read().rpartition(")")[2].split()
            except OSError:
                continue
            if int(entry) in wanted or int(fields[1]) in wanted:
                total += int(fields[11]) + int(fields[12])
    return total / TICKS


def figure(size):
    """An OBJ of a figure made of boxes, `size` times as large as the next one: a body, a head, arms and legs."""
    boxes = [
        ((0, 1.1, 0), (0.25, 0.35, 0.15)), ((0, 1.65, 0), (0.15, 0.2, 0.15)),
        ((-0.6, 1.35, 0), (0.4, 0.08, 0.08)), ((0.6, 1.35, 0), (0.4, 0.08, 0.08)),
        ((-0.15, 0.4, 0), (0.1, 0.4, 0.1)), ((0.15, 0.4, 0), (0.1, 0.4, 0.1)),
    ]
    corners = [(-1, -1, -1), (1, -1, -1), (1, 1, -1), (-1, 1, -1), (-1, -1, 1), (1, -1, 1), (1, 1, 1), (-1, 1, 1)]
    faces = [(1, 4, 3, 2), (5, 6, 7, 8), (1, 2, 6, 5), (2, 3, 7, 6), (3, 4, 8, 7), (4, 1, 5, 8)]
    lines = []
    for index, (centre, half) in enumerate(boxes):
        for corner in corners:
            place = [size * (centre[axis] + half[axis] * corner[axis]) for axis in range(3)]
            lines.append("v %.6f %.6f %.6f" % tuple(place))
        for face in faces:
            lines.append("f " + " ".join(str(corner + 8 * index) for corner in face))
    return ("\n".join(lines) + "\n").encode()


def heavy_sheet(side):
    """An OBJ of a bumpy closed slab with about 4 · side² faces: a mesh of any number of bytes."""
    lines = []
    for layer in (0, 1):
        for row in range(side):
            for column in range(side):
                bump = 0.02 * ((row * 7 + column * 13) % 11)
                lines.append("v %.5f %.5f %.5f" % (column / side, 2 * row / side, 0.2 * layer + bump))
    def vertex(layer, row, column):
        return layer * side * side + row * side + column + 1
    for row in range(side - 1):
        for column in range(side - 1):
            for layer in (0, 1):
                quad = [(row, column), (row, column + 1), (row + 1, column + 1), (row + 1, column)]
                quad = quad if layer else quad[::-1]
                lines.append("f " + " ".join(str(vertex(layer, *corner)) for corner in quad))
    return ("\n".join(lines) + "\n").encode()
