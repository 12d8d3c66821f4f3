"""A batch of many meshes, some of them broken, and the service killed while it works on it.

Uploads the meshes, orders them as one batch of JSON lines, kills the service when a third and when two thirds of the items are
over, and starts it again at once. When the batch is over: every sound mesh has its rig, every broken one its error by name, the
results are in the order of the items, no item became two jobs, and the rigged files have the bytes that their digests say.
"""

import argparse
import collections
import hashlib
import json
import os
import shutil
import tempfile
import time

from service import Service, figure

BROKEN = [
    (b"v 0 0 0\nv 1 0 0\n", "no_geometry"),
    (b"v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "non_finite_vertices"),
    (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "unreadable_mesh"),
]


def until_over(service, path, items, wait_s):
    """Waits until `items` of the batch are over; gives the batch."""
    until = time.monotonic() + wait_s
    while True:
        batch = service.json(path)
        counts = batch["counts"]
        if counts["succeeded"] + counts["failed"] + counts["canceled"] >= items:
            return batch
        if time.monotonic() > until:
            raise RuntimeError(f"{path} is not that far after {wait_s} s: {counts}")
        time.sleep(0.2)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binary", default="target/release/rigsmith")
    parser.add_argument("--meshes", type=int, default=500)
    parser.add_argument("--broken", type=int, default=25)
    parser.add_argument("--kills", type=int, default=2)
    parser.add_argument("--wait-s", type=float, default=7200)
    arguments = parser.parse_args()
    folder = tempfile.mkdtemp(prefix="rigsmith-batch-")
    service = Service(arguments.binary, os.path.join(folder, "data"), os.path.join(folder, "log")).start()
    expected, lines = [], []
    every = arguments.meshes // arguments.broken
    for number in range(arguments.meshes):
        kind, sound = divmod(number, every)
        mesh, code = (figure(1 + number / 1000), None) if sound or kind >= arguments.broken else BROKEN[kind % len(BROKEN)]
        name = f"figure-{number}"
        if code:
            mesh += b"# %d\n" % number
        status, _, body = service.request(
            "POST", f"/v1/assets?file_name={name}.obj", body=mesh, headers={"Content-Type": "application/octet-stream"}
        )
        assert status == 201, body
        expected.append((name, code))
        lines.append(json.dumps({"custom_id": name, "request": {"asset": json.loads(body)["id"]}}))
    began = time.monotonic()
    status, _, body = service.request(
        "POST", "/v1/batches", body="\n".join(lines).encode(), headers={"Content-Type": "application/jsonl"}
    )
    assert status == 202, body
    path = json.loads(body)["links"]["self"]
    for kill in range(arguments.kills):
        batch = until_over(service, path, arguments.meshes * (kill + 1) // (arguments.kills + 1), arguments.wait_s)
        service.kill()
        print(f"killed at {batch['counts']}", flush=True)
        service.start()
    batch = until_over(service, path, arguments.meshes, arguments.wait_s)
    while batch["state"] == "running":
        time.sleep(0.2)
        batch = service.json(path)
    seconds = time.monotonic() - began
    _, _, body = service.request("GET", path + "/results", timeout_s=120)
    results = [json.loads(line) for line in body.splitlines()]
    said = [(result["custom_id"], result.get("error", {}).get("code")) for result in results]
    wrong = [(is_, should) for is_, should in zip(said, expected) if is_ != should]
    jobs, token = 0, ""
    while True:
        page = service.json(f"/v1/rigs?page_size=100{token}")
        jobs += len(page["data"])
        if not page["next_page_token"]:
            break
        token = f"&page_token={page['next_page_token']}"
    damaged = 0
    for result in results:
        for artifact in (result.get("rig") or {"result": {"artifacts": []}})["result"]["artifacts"]:
            _, _, data = service.request("GET", artifact["url"])
            damaged += hashlib.sha256(data).hexdigest() != artifact["sha256"]
    repeated = sum(result["rig"]["attempt"] > 1 for result in results if "rig" in result)
    service.stop()
    codes = collections.Counter(code or "rig" for _, code in said)
    print(f"{len(results)} results in {seconds:.0f} s: {dict(codes)}; {jobs} jobs, {repeated} begun again after a kill")
    print(f"{len(wrong)} other than expected, {damaged} files with other bytes than their digest")
    for is_, should in wrong[:10]:
        print(f"  {is_} instead of {should}")
    shutil.rmtree(folder)
    fine = not wrong and not damaged and len(results) == arguments.meshes == jobs and batch["state"] == "completed"
    print("fine" if fine else "NOT FINE")
    return 0 if fine else 1


if __name__ == "__main__":
    raise SystemExit(main())
