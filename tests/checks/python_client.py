"""A Python client that is made from the OpenAPI document drives upload, watch and download.

    python python_client.py [--binary FILE]

The built program is started in an empty folder; openapi-python-client writes a client from its OpenAPI document; the client
does what the names of the claims below say, against the same service. The client is not kept. Ends with the summary that
`make test` adds up.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib
import io
import json
import subprocess
import sys
import tempfile
import traceback
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT / "clients/python"))

import generate  # noqa: E402

SAMPLE = ROOT / "tests/fixtures/sample-character.glb"
PACKAGE = "rigsmith_client"
WAIT = "wait=60"


def started(binary: Path, folder: Path) -> tuple[subprocess.Popen, str]:
    command = [binary, "serve", "--listen", "127.0.0.1:0", "--data", folder / "data"]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    for line in process.stdout:
        if "listens on" in line:
            return process, line.split("listens on ")[1].split()[0]
    raise SystemExit("the service did not start")


class Claims:
    """Each method is one claim; they run in this order and stand on each other."""

    def __init__(self, host: str) -> None:
        module = importlib.import_module
        self.client = module(PACKAGE).Client(base_url=host, timeout=120)
        self.models = module(f"{PACKAGE}.models")
        self.File = module(f"{PACKAGE}.types").File

    def answer(self, group: str, name: str, *arguments, **named):
        operation = importlib.import_module(f"{PACKAGE}.api.{group}.{name}")
        return operation.sync_detailed(*arguments, client=self.client, **named)

    def ask(self, *arguments, **named):
        """What an operation answers, read by the client."""
        answer = self.answer(*arguments, **named)
        assert answer.status_code < 300, answer
        return answer.parsed

    def refused(self, *arguments, **named):
        """The problem that an operation answers with."""
        answer = self.answer(*arguments, **named)
        assert isinstance(answer.parsed, self.models.Problem) and answer.parsed.status == answer.status_code, answer
        return answer.parsed

    def mesh(self):
        return self.File(payload=io.BytesIO(SAMPLE.read_bytes()), file_name="hero.glb")

    def an_upload_is_an_asset_that_tells_what_it_holds(self) -> None:
        self.asset = self.ask("assets", "create_asset", body=self.mesh(), file_name="hero.glb")
        assert self.asset.sha256 == hashlib.sha256(SAMPLE.read_bytes()).hexdigest()
        assert self.asset.mesh.faces > 0 and self.asset.existing.skins == 0, self.asset
        assert self.ask("assets", "get_asset", self.asset.id).sha256 == self.asset.sha256

    def a_check_says_what_would_be_rigged(self) -> None:
        check = self.ask("rigs", "check_rig", body=self.models.CreateRig(asset=self.asset.id))
        assert check.riggable == self.models.Riggable.YES and check.category == self.models.Category.BIPED, check
        assert len(check.symmetry.plane.normal) == 3 and check.estimate.seconds > 0, check

    def a_rig_of_the_asset_is_taken_with_options_and_labels(self) -> None:
        create = self.models.CreateRig(
            asset=self.asset.id, detail=0.4, symmetry=self.models.Symmetry.ON, priority=self.models.Priority.HIGH,
            outputs=[self.models.Output.GLB, self.models.Output.RIG_JSON],
        )  # fmt: skip
        self.rig = self.ask("rigs", "create_rig", body=create, idempotency_key="python-client")
        assert self.rig.request.detail == 0.4 and self.rig.request.symmetry == self.models.Symmetry.ON, self.rig
        assert self.ask("rigs", "create_rig", body=create, idempotency_key="python-client").id == self.rig.id

    def its_events_are_watched_to_the_end(self) -> None:
        ticket = self.ask("rigs", "ticket_rig", self.rig.id)
        names, last = [], None
        with self.client.get_httpx_client().stream("GET", ticket.url) as lines:
            for line in lines.iter_lines():
                if line.startswith("event: "):
                    names.append(line.removeprefix("event: "))
                if line.startswith("data: "):
                    last = json.loads(line.removeprefix("data: "))
        assert names[0] == "snapshot" and names[-1] == "done" and last["state"] == "succeeded", names

    def the_finished_rig_is_read(self) -> None:
        rig = self.ask("rigs", "get_rig", self.rig.id, prefer=WAIT)
        assert rig.state == self.models.RigState.SUCCEEDED and rig.progress == 100, rig
        assert rig.finished_at >= rig.started_at >= rig.created_at, rig
        assert rig.result["skeleton"]["joints"] > 1, rig

    def its_files_are_downloaded_whole(self) -> None:
        files = self.ask("artifacts", "list_artifacts", self.rig.id).data
        assert {file.name for file in files} == {"rigged.glb", "rig.json"}, files
        for file in files:
            content = self.ask("artifacts", "get_artifact", self.rig.id, file.name).payload.read()
            assert len(content) == file.bytes_ and hashlib.sha256(content).hexdigest() == file.sha256, file

    def another_form_is_exported(self) -> None:
        export = self.models.ExportRig(output=self.models.Output.GLTF, max_influences=2)
        document = json.loads(self.ask("rigs", "export_rig", self.rig.id, body=export).payload.read())
        assert len(document["skins"]) == 1, document["asset"]

    def a_form_is_rigged_in_one_call(self) -> None:
        form = self.models.RigForm(file=self.mesh(), options=self.models.RigOptions(detail=0.2))
        rig = self.ask("rigs", "create_rig", body=form, prefer=WAIT)
        assert rig.state == self.models.RigState.SUCCEEDED and rig.request.detail == 0.2, rig

    def rigs_are_listed_and_deleted(self) -> None:
        rigs = self.ask("rigs", "list_rigs", state=self.models.RigState.SUCCEEDED, page_size=50).data
        assert self.rig.id in [rig.id for rig in rigs], rigs
        assert self.ask("rigs", "delete_rig", self.rig.id) is None
        assert self.refused("rigs", "get_rig", self.rig.id).code == "not_found"

    def a_refusal_is_read_as_a_problem(self) -> None:
        problem = self.refused("rigs", "create_rig", body=self.models.CreateRig(asset=self.asset.id, detail=1.5))
        assert problem.code == "invalid_parameter" and problem.errors[0].field == "detail", problem


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--binary", type=Path, default=ROOT / "target/release/rigsmith")
    binary = parser.parse_args().binary
    passed = failed = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        process, host = started(binary, folder)
        try:
            generate.write_api(generate.document_of(binary), folder / PACKAGE)
            sys.path.insert(0, name)
            claims = Claims(host)
            for claim in [member for member in vars(Claims) if "_" in member.strip("_")]:
                try:
                    getattr(claims, claim)()
                    passed += 1
                except Exception:  # whatever it is, the other claims are tried
                    failed += 1
                    print(f"FAILED: {claim.replace('_', ' ')}\n{traceback.format_exc()}")
        finally:
            process.terminate()
            process.wait(60)
    print(f"python client: {passed} passed, {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
