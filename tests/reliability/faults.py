"""What goes wrong around the service, one fault at a time, and what becomes of the jobs. Prints a table.

The faults inside the process (a panicking stage, a late worker, a stepping clock, a job that takes too much memory) are
tests: `cargo test --release --test it -- jobs:: jobs_store::`.

Filling a disk needs the right to mount a tmpfs, and the read-only database the right to set the immutable attribute;
without them these rows say so.
"""

import argparse
import json
import os
import shutil
import signal
import sqlite3
import subprocess
import tempfile
import time

from service import Service, figure, heavy_sheet

LEASE_S = 15


class Skipped(Exception):
    """The machine does not allow this fault."""


def code(answer):
    status, _, body = answer
    try:
        return status, json.loads(body).get("code", "")
    except ValueError:
        return status, ""


def submitted(service, number, **how):
    status, _, body = service.rig(figure(1 + number / 1000), **how)
    assert status in (200, 202), (status, body[:300])
    return f"/v1/rigs/{json.loads(body)['id']}"


def succeeds(service, number):
    job, _ = service.until_over(submitted(service, number), 300)
    assert job["state"] == "succeeded", job["error"]
    return job


def ends(data, job):
    database = sqlite3.connect(f"file:{os.path.join(data, 'jobs.db')}?mode=ro", uri=True)
    return sum(1 for (body,) in database.execute("SELECT body FROM events") if json.loads(body)["event"] == "done")


def full_disk(binary, folder):
    """A tmpfs of 16 MiB is filled to the last page, and emptied again."""
    data = os.path.join(folder, "data")
    os.mkdir(data)
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=16m", "tmpfs", data], capture_output=True).returncode:
        raise Skipped("mounting a tmpfs is not allowed here")
    try:
        service = Service(binary, data, os.path.join(folder, "log")).start()
        done = succeeds(service, 1)
        ballast = os.path.join(data, "ballast")
        file = os.open(ballast, os.O_WRONLY | os.O_CREAT)
        try:
            while os.write(file, b"x" * 4096):
                pass
        except OSError:
            os.close(file)
        refusals = {code(service.rig(figure(1 + number / 1000)))[1] for number in range(2, 12)}
        big = code(service.rig(b"v 0 0 0\n" * 200_000))
        assert service.request("GET", "/livez")[0] == 200
        job = service.json(f"/v1/rigs/{done['id']}")
        kept = [service.request("GET", artifact["url"])[0] for artifact in job["result"]["artifacts"]]
        os.remove(ballast)
        succeeds(service, 20)
        assert service.stop() == 0
        return (f"small requests are answered {sorted(refusals)}, a large upload {big[0]} {big[1]}; what was kept is "
                f"{job['state']}, downloads answer {sorted(set(kept))}; with room again, the next job succeeds")
    finally:
        subprocess.run(["umount", "-l", data], check=True)


def full_quota(binary, folder):
    """`--keep-mib 1`: the service's own bound on what it keeps."""
    data = os.path.join(folder, "data")
    service = Service(binary, data, os.path.join(folder, "log"), ["--keep-mib", "1"]).start()
    too_big = code(service.rig(heavy_sheet(150)))
    first = succeeds(service, 1)
    number, state = 1, "succeeded"
    while state == "succeeded" and number < 40:
        number += 1
        # Padded, so that few jobs fill the quota.
        mesh = figure(1 + number / 1000) + b"# padding\n" * 10_000
        status, _, body = service.rig(mesh)
        assert status == 202, (status, body[:300])
        job, _ = service.until_over(f"/v1/rigs/{json.loads(body)['id']}", 300)
        assert job["state"] == "succeeded", job["error"]
        state = service.json(f"/v1/rigs/{first['id']}")["state"]
    kept = sum(entry.stat().st_size for entry in os.scandir(os.path.join(data, "blobs")))
    assert state == "expired" and kept <= 1 << 20, (state, kept)
    assert service.stop() == 0
    return (f"an upload that can never fit is refused with {too_big[0]} {too_big[1]}; after {number} jobs the oldest result "
            f"has expired to make room ({kept // 1024} KiB kept), and every job succeeded")


def stopped_process(binary, folder):
    """SIGSTOP for longer than a lease, then SIGCONT."""
    data = os.path.join(folder, "data")
    service = Service(binary, data, os.path.join(folder, "log")).start()
    path = submitted(service, 1)
    while service.json(path)["state"] == "queued":
        time.sleep(0.01)
    service.signal(signal.SIGSTOP)
    time.sleep(LEASE_S + 5)
    service.signal(signal.SIGCONT)
    job, _ = service.until_over(path, 300)
    assert job["state"] == "succeeded", job
    assert service.stop() == 0
    assert ends(data, job) == 1
    return f"the job succeeded in attempt {job['attempt']}, and ended once"


def lost_twice(binary, folder):
    """SIGKILL while the same job runs, twice."""
    data = os.path.join(folder, "data")
    service = Service(binary, data, os.path.join(folder, "log")).start()
    path = submitted(service, 1)
    for _ in range(2):
        while service.json(path)["state"] == "queued":
            time.sleep(0.005)
        service.kill()
        service.start()
    job, _ = service.until_over(path, 60)
    assert (job["state"], job["error"]["code"]) == ("failed", "worker_lost"), job
    succeeds(service, 2)
    assert service.stop() == 0
    return f"failed with {job['error']['code']}, retryable: {job['error']['retryable']}; the next job succeeded"


def too_much_memory(binary, folder):
    """`--memory-mib 256` and an OBJ that needs more."""
    service = Service(binary, os.path.join(folder, "data"), os.path.join(folder, "log"), ["--memory-mib", "256"]).start()
    status, _, body = service.rig(heavy_sheet(550))
    problem = json.loads(body)
    assert problem["code"] == "out_of_memory", problem
    succeeds(service, 1)
    assert service.stop() == 0
    return f"refused with {status} out_of_memory, limit {json.dumps(problem['limit'])}; a small job succeeded"


def read_only_database(binary, folder):
    """The database becomes immutable while the service runs, and before it starts."""
    data = os.path.join(folder, "data")
    service = Service(binary, data, os.path.join(folder, "log")).start()
    done = succeeds(service, 1)
    files = [os.path.join(data, name) for name in os.listdir(data) if name.startswith("jobs.db")]
    if subprocess.run(["chattr", "+i", *files], capture_output=True).returncode:
        service.kill()
        raise Skipped("the immutable attribute cannot be set here")
    try:
        refused = code(service.rig(figure(2)))
        assert service.request("GET", "/livez")[0] == 200
        state = service.json(f"/v1/rigs/{done['id']}")["state"]
        service.kill()
        try:
            service.start(wait_s=60)
            started = "starts all the same"
            service.kill()
        except RuntimeError:
            with open(service.log, encoding="utf-8") as log:
                lines = [line for line in log if "error" in line.lower() or "jobs.db" in line]
            started = "refuses to start: " + lines[-1].strip().replace(data, "DATA")[:160]
    finally:
        subprocess.run(["chattr", "-i", *files], capture_output=True)
    service.start()
    assert service.json(f"/v1/rigs/{done['id']}")["state"] == "succeeded"
    succeeds(service, 3)
    assert service.stop() == 0
    return (f"a new job is answered {refused[0]} {refused[1]}, a look at an old one {state}; a new process {started}; "
            "writable again, it goes on")


def cancel_at_any_time(binary, folder):
    """`:cancel` at twenty moments of a running job."""
    service = Service(binary, os.path.join(folder, "data"), os.path.join(folder, "log")).start()
    _, alone_s = service.until_over(submitted(service, 100), 300)
    took, stages = [], set()
    for number in range(20):
        path = submitted(service, number)
        while service.json(path)["state"] == "queued":
            time.sleep(0.005)
        time.sleep(alone_s * number / 20)
        asked = time.monotonic()
        status = service.request("POST", f"{path}:cancel")[0]
        job, _ = service.until_over(path, 60)
        if status == 200 and job["state"] == "canceled":
            took.append(time.monotonic() - asked)
            stages.add(job["stage"] or "none")
    assert took and max(took) <= 2.5, took
    assert service.stop() == 0
    return f"{len(took)} were canceled in time, in {', '.join(sorted(stages))}; the slowest after {max(took):.1f} s"


def second_process(binary, folder):
    """A second service on the same folder."""
    data = os.path.join(folder, "data")
    service = Service(binary, data, os.path.join(folder, "log")).start()
    second = Service(binary, data, os.path.join(folder, "log2"))
    try:
        second.start(wait_s=60)
        raise AssertionError("a second service started")
    except RuntimeError:
        status = second.process.wait()
    with open(second.log, encoding="utf-8") as log:
        said = log.read().strip().splitlines()[0].replace(data, "DATA")
    succeeds(service, 1)
    assert service.stop() == 0
    return f"exit status {status}, “{said[:140]}”; the first one goes on"


def cut_upload(binary, folder):
    """SIGKILL in the middle of an upload."""
    data = os.path.join(folder, "data")
    service = Service(binary, data, os.path.join(folder, "log")).start()
    import socket
    with socket.create_connection(("127.0.0.1", service.port)) as caller:
        head = "POST /v1/rigs?file_name=a.obj HTTP/1.1\r\nHost: x\r\nContent-Type: application/octet-stream\r\n"
        caller.sendall(f"{head}Content-Length: 9000000\r\n\r\n".encode() + b"v 0 0 0\n" * 400_000)
        time.sleep(1)
        half = len(os.listdir(os.path.join(data, "incoming")))
        service.kill()
    service.start()
    left = len(os.listdir(os.path.join(data, "incoming"))) + len(os.listdir(os.path.join(data, "blobs")))
    jobs = len(service.json("/v1/rigs")["data"])
    assert (half, left, jobs) == (1, 0, 0), (half, left, jobs)
    assert service.stop() == 0
    return "no job, and no byte of it left after the next start"


FAULTS = [full_disk, full_quota, stopped_process, lost_twice, too_much_memory, read_only_database,
          cancel_at_any_time, second_process, cut_upload]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binary", default="target/release/rigsmith")
    parser.add_argument("--only", choices=[fault.__name__ for fault in FAULTS])
    arguments = parser.parse_args()
    print("| fault | outcome |\n|---|---|", flush=True)
    failed = False
    for fault in FAULTS:
        if arguments.only not in (None, fault.__name__):
            continue
        folder = tempfile.mkdtemp(prefix="rigsmith-fault-")
        try:
            outcome = fault(os.path.abspath(arguments.binary), folder)
        except Skipped as skipped:
            outcome = f"not tried: {skipped}"
        except Exception as error:
            failed, outcome = True, f"**FAILED** {type(error).__name__}: {error}"
        print(f"| {fault.__doc__.rstrip('.')} | {outcome} |", flush=True)
        for service in Service.started:
            if service.process and service.process.poll() is None:
                service.kill()
        Service.started.clear()
        if not failed:
            shutil.rmtree(folder)
    raise SystemExit(failed)


if __name__ == "__main__":
    main()
