"""A stock tus client (tuspy) uploads to the built service, which is killed and started again in the middle.

    python stock_tus.py

Starts `target/release/rigsmith serve` on a folder of its own. Ends with the summary that `make test` adds up.
"""

from __future__ import annotations

import hashlib
import io
import json
import sys
import tempfile
import traceback
from pathlib import Path

from tusclient.client import TusClient

ROOT = Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT / "tests/reliability"))

from service import Service  # noqa: E402

SAMPLE = (ROOT / "tests/fixtures/sample-character.glb").read_bytes()
CHUNK = len(SAMPLE) // 7


def uploader(service: Service, url: str | None = None, content: bytes = SAMPLE, **settings):
    client = TusClient(f"http://127.0.0.1:{service.port}/v1/uploads")
    stream = io.BytesIO(content)
    return client.uploader(file_stream=stream, url=url, chunk_size=CHUNK, metadata={"filename": "hero.glb"}, **settings)


def asset_of(service: Service, url: str) -> dict:
    upload = service.json(url.removeprefix(f"http://127.0.0.1:{service.port}"))
    assert upload["offset"] == upload["length"], upload
    return service.json(upload["links"]["asset"])


def parts_become_an_asset_that_can_be_rigged(service: Service):
    upload = uploader(service)
    upload.upload()
    asset = asset_of(service, upload.url)
    assert asset["sha256"] == hashlib.sha256(SAMPLE).hexdigest() and asset["files"][0]["name"] == "hero.glb", asset
    body = json.dumps({"asset": asset["id"], "detail": 0.4})
    fields = {"Content-Type": "application/json", "Prefer": "wait=60"}
    status, _, answer = service.request("POST", "/v1/rigs", body=body, headers=fields, timeout_s=90)
    assert status == 200 and json.loads(answer)["state"] == "succeeded", answer[:500]


def checksums_are_looked_at(service: Service):
    content = SAMPLE[: CHUNK + 5] + b"checked"
    upload = uploader(service, content=content, upload_checksum=True)
    upload.upload()
    assert asset_of(service, upload.url)["sha256"] == hashlib.sha256(content).hexdigest()


def a_killed_service_goes_on_where_it_was(service: Service):
    content = SAMPLE + b"killed"
    upload = uploader(service, content=content)
    upload.upload(stop_at=3 * CHUNK)
    service.kill()
    service.start()
    again = uploader(service, url=upload.url, content=content)
    assert again.offset == 3 * CHUNK, again.offset
    again.upload()
    assert asset_of(service, upload.url)["sha256"] == hashlib.sha256(content).hexdigest()


CHECKS = [parts_become_an_asset_that_can_be_rigged, checksums_are_looked_at, a_killed_service_goes_on_where_it_was]


def main() -> int:
    failed = 0
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        service = Service(str(ROOT / "target/release/rigsmith"), str(folder / "data"), str(folder / "log")).start()
        try:
            for check in CHECKS:
                try:
                    check(service)
                except Exception:
                    failed += 1
                    print(f"{check.__name__.replace('_', ' ')}: FAILED\n{traceback.format_exc()}")
        finally:
            service.stop()
    print(f"stock tus client: {len(CHECKS) - failed} passed, {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
