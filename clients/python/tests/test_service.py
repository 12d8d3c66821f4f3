"""The package against the running service."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import PACKAGE, SAMPLE

import rigsmith

BROKEN = b"v 0 0 0\nf 1 2 3\n"


@pytest.fixture
def client(server: str):
    with rigsmith.Client(server) as client:
        yield client


def test_one_call_writes_what_the_names_ask_for(server: str, knight: Path):
    out = [knight.parent / name for name in ["rigged.glb", "knight.rig.json", "knight.png"]]
    made = rigsmith.rig(knight, out, server=server, detail=0.4)
    assert made.state == "succeeded" and made.request.detail == 0.4
    assert out[0].read_bytes()[:4] == b"glTF" and out[2].read_bytes()[1:4] == b"PNG"
    assert len(json.loads(out[1].read_text())["joints"]) == made.result["skeleton"]["joints"]
    left = sorted(path.name for path in knight.parent.iterdir())
    assert left == ["knight.glb", "knight.png", "knight.rig.json", "rigged.glb"], "nothing else is left"


def test_the_examples_of_the_readme_run(server: str, knight: Path):
    blocks = re.findall(r"```python\n(.*?)```", (PACKAGE / "README.md").read_text(), re.DOTALL)
    assert len(blocks) == 3
    environment = {"RIGSMITH_SERVER": server, "PYTHONPATH": str(PACKAGE / "src")}
    ran = subprocess.run(
        [sys.executable, "-c", "\n".join(blocks)], cwd=knight.parent, env=environment, capture_output=True, text=True
    )
    assert ran.returncode == 0, ran.stderr
    said = ran.stdout.splitlines()
    assert said[0].endswith("joints") and said[1].startswith("yes ") and said[-1].startswith("invalid_parameter detail "), said
    assert "done None" in said and said[-3].startswith("first rig_") and said[-2].startswith("second rig_"), said
    for name in ["knight-rigged.glb", "few-joints.glb", "skinned.glb"]:
        assert (knight.parent / name).read_bytes()[:4] == b"glTF", name


def test_a_key_of_the_caller_makes_one_rig_of_two_requests(client: rigsmith.Client):
    mesh = SAMPLE.read_bytes()
    first = client.submit(mesh, idempotency_key="twice", seed=11)
    assert client.submit(mesh, idempotency_key="twice", seed=11).id == first.id
    with pytest.raises(rigsmith.InvalidRequest) as refused:
        client.submit(mesh, idempotency_key="twice", seed=12)
    assert refused.value.code == "idempotency_mismatch" and refused.value.status == 422


def test_watching_begins_with_the_rig_and_ends_with_it(client: rigsmith.Client):
    events = list(client.watch(client.submit(SAMPLE, seed=12)))
    assert events[0].name == "snapshot" and events[-1].name == "done"
    assert events[-1].data["state"] == "succeeded"
    assert [int(event.id) for event in events] == sorted({int(event.id) for event in events})


def test_files_beside_the_mesh_are_sent_with_it(client: rigsmith.Client, tmp_path: Path):
    (tmp_path / "box.obj").write_bytes(b"mtllib box.mtl\nusemtl skin\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "box.mtl").write_bytes(b"newmtl skin\n")
    asset = client.upload(tmp_path / "box.obj", beside=[tmp_path / "box.mtl"])
    assert [file.name for file in asset.files] == ["box.obj", "box.mtl"]


def test_a_mesh_that_cannot_be_rigged_is_a_rig_that_failed(client: rigsmith.Client):
    with pytest.raises(rigsmith.RigFailed) as failed:
        client.rig(b"v 0 0 0\n")
    error = failed.value
    assert (error.state, error.code) == ("failed", "no_geometry") and error.rig_id.startswith("rig_") and error.hint
    assert client.get(error.rig_id).state == "failed"


def test_one_bad_mesh_fails_alone_in_a_batch(client: rigsmith.Client):
    results = client.batch({"bad": BROKEN, "good": SAMPLE, "also": client.upload(SAMPLE)}, detail=0.4)
    assert [result.custom_id for result in results] == ["bad", "good", "also"]
    bad, good, also = results
    assert bad.error and bad.error.code == "unreadable_mesh" and bad.error.hint
    assert good.rig and also.rig and good.rig.state == also.rig.state == "succeeded"


def test_refusals_are_told_by_kind(client: rigsmith.Client, tmp_path: Path):
    with pytest.raises(rigsmith.NotFound) as missing:
        client.get("rig_01jdf5fj63fh5ra1njpy75fmyg")
    assert missing.value.code == "not_found" and missing.value.request_id and not missing.value.retryable
    with pytest.raises(rigsmith.InvalidRequest) as refused:
        client.check(SAMPLE, detail=7, max_influences=99)
    assert [error.field for error in refused.value.errors] == ["detail", "max_influences"]
    made = client.rig(SAMPLE, seed=13)
    with pytest.raises(rigsmith.Conflict):
        client.cancel(made)
    with pytest.raises(rigsmith.NotFound):
        client.download(made, "rigged.fbx", tmp_path / "rigged.fbx")
    assert not list(tmp_path.iterdir()), "a file that was not there leaves nothing"
    assert client.read(made, "rigged.glb")[:4] == b"glTF"
    client.delete(made)
    with pytest.raises(rigsmith.NotFound):
        client.get(made)


def test_the_generated_operations_are_at_hand(client: rigsmith.Client):
    from rigsmith.api.api.rigs import list_rigs

    made = client.submit(SAMPLE, seed=14, labels={"project": "at hand"})
    listed = list_rigs.sync(client=client.api, label="project=at hand")
    assert [rig.id for rig in listed.data] == [made.id]
