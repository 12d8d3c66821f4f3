"""What the package does where a service, or the way to it, fails: against answers that are made up."""

from __future__ import annotations

import base64
import hashlib
import json
import subprocess
import sys
from pathlib import Path

import httpx
import pytest
from conftest import PACKAGE

import rigsmith

RIG = "rig_01jdf5fj63fh5ra1njpy75fmyg"
PROBLEM = {"code": "queue_full", "title": "The queue is full", "detail": "100 jobs are waiting", "hint": "send it again",
           "retryable": True, "request_id": "0193", "status": 429}  # fmt: skip


class Scripted(httpx.BaseTransport):
    """Gives the answers of a list, one a request; an exception is raised. Keeps what it was asked."""

    def __init__(self, *answers: httpx.Response | Exception):
        self.answers, self.asked = list(answers), []

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        request.read()
        self.asked.append(request)
        answer = self.answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer


def client(*answers: httpx.Response | Exception, patience: float = 30.0) -> tuple[rigsmith.Client, Scripted]:
    script = Scripted(*answers)
    return rigsmith.Client("http://service", "secret", patience=patience, transport=script), script


def busy(seconds: int = 0) -> httpx.Response:
    return httpx.Response(429, json=PROBLEM, headers={"Retry-After": str(seconds)})


def asset(**others) -> httpx.Response:
    example = {"id": "ast_01", "object": "asset", "sha256": "00", "bytes": 4, "files": [], "created_at": "2026-11-26T10:20:07.042Z",
               "expires_at": "2026-11-27T10:20:07.042Z", "mesh": None, "existing": None, "findings": [],
               "links": {"self": "/v1/assets/ast_01", "content": "/v1/assets/ast_01/content"}}  # fmt: skip
    return httpx.Response(201, json={**example, **others})


def events(*lines: str) -> httpx.Response:
    return httpx.Response(200, text="".join(lines), headers={"Content-Type": "text/event-stream"})


def event(sequence: int, name: str, **data) -> str:
    return f"id: {sequence}\nevent: {name}\ndata: {json.dumps(data)}\n\n"


def test_a_busy_service_is_asked_again_with_the_same_request():
    asking, script = client(httpx.ConnectError("refused"), busy(), asset())
    assert asking.upload(b"mesh").id == "ast_01"
    assert len({request.content.replace(boundary(request), b"") for request in script.asked}) == 1
    assert script.asked[0].headers["authorization"] == "Bearer secret"


def boundary(request: httpx.Request) -> bytes:
    return request.headers["content-type"].partition("boundary=")[2].encode()


def test_patience_ends_with_what_the_service_said():
    asking, script = client(busy(3600))
    with pytest.raises(rigsmith.Busy) as refused:
        asking.upload(b"mesh")
    error = refused.value
    assert (error.code, error.detail, error.hint, error.request_id) == (
        "queue_full",
        "100 jobs are waiting",
        "send it again",
        "0193",
    )
    assert error.retry_after == 3600 and len(script.asked) == 1
    assert str(error) == "queue_full: 100 jobs are waiting (send it again)"


def test_where_nobody_ever_answered_it_is_told_soon():
    asking, _ = client(*[httpx.ConnectError("refused")] * 99, patience=3600)
    with pytest.raises(rigsmith.Unreachable, match="http://service.* does not answer: refused"):
        asking.upload(b"mesh")


def test_a_stranger_is_told_from_a_service():
    for answer in [
        httpx.Response(502, text="Bad Gateway"),
        httpx.Response(200, text="<html>"),
        httpx.Response(200, json={"id": 1}),
    ]:
        with pytest.raises(rigsmith.NotUnderstood, match="http://service/v1/assets"):
            client(answer)[0].upload(b"mesh")


def test_unknown_members_of_an_answer_are_no_fault():
    assert client(asset(colour="blue"))[0].upload(b"mesh").id == "ast_01"


def test_a_stream_that_breaks_is_taken_up_where_it_was():
    first = events(
        "retry: 2000\n\n", event(1, "snapshot", state="queued"), event(2, "state", state="running"), "id: 3\nevent: progr"
    )
    rest = events(": still here\n\n", event(3, "progress", progress=40), event(4, "done", state="succeeded"))
    asking, script = client(first, httpx.ReadError("broke"), rest)
    assert [(seen.id, seen.name) for seen in asking.watch(RIG)] == [
        ("1", "snapshot"),
        ("2", "state"),
        ("3", "progress"),
        ("4", "done"),
    ]
    assert [request.headers.get("last-event-id") for request in script.asked] == [None, "2", "2"]


def test_a_stream_with_nothing_more_to_come_ends():
    assert list(client(httpx.Response(204))[0].watch(RIG)) == []


def test_what_came_damaged_is_fetched_again_and_never_written(tmp_path: Path):
    whole, to = b"glTF and so on", tmp_path / "rigged.glb"
    digest = {"Repr-Digest": f"sha-256=:{base64.b64encode(hashlib.sha256(whole).digest()).decode()}:"}
    asking, script = client(
        httpx.Response(200, content=whole[:-1], headers=digest), httpx.Response(200, content=whole, headers=digest)
    )
    asking.download(RIG, "rigged.glb", to)
    assert to.read_bytes() == whole and len(script.asked) == 2
    to.unlink()
    with pytest.raises(rigsmith.Broken, match="digest"):
        client(*[httpx.Response(200, content=b"glTF", headers=digest)] * 2, patience=0)[0].download(RIG, "rigged.glb", to)
    assert not list(tmp_path.iterdir())


def test_names_that_would_leave_the_path_are_not_sent():
    for name in ["..", "", "a/b", "a?b", "ä"]:
        with pytest.raises(ValueError, match="neither of a rig nor of its files"):
            client()[0].get(name)


def test_the_package_and_what_is_asked_of_it_are_typed():
    ran = subprocess.run([sys.executable, "-m", "mypy"], cwd=PACKAGE, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stdout
    usage = 'import rigsmith\nrigsmith.rig("a.glb", detail=0.7, symmetry="on")\nrigsmith.rig("a.glb", symmetry="sideways", colour=1)\n'
    command = [sys.executable, "-m", "mypy", "--config-file=", "--follow-imports=silent", "--strict", "-c", usage]
    ran = subprocess.run(
        command, check=False, env={"MYPYPATH": str(PACKAGE / "src")}, cwd=PACKAGE, capture_output=True, text=True
    )
    assert 'Unexpected keyword argument "colour"' in ran.stdout and "Literal['sideways']" in ran.stdout, ran.stdout
    assert "<string>:2:" not in ran.stdout, ran.stdout
