"""The steps of rigging by a service, each a method; and all of them in one call."""

from __future__ import annotations

import io
import json
import os
import time
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, Self, TypeVar, Unpack

import httpx

from . import api
from .api.models import Asset, Batch, BatchResult, Check, Rig
from .errors import Broken, InvalidRequest, NotFinished, NotUnderstood, Refused, RigFailed, Unreachable, refusal, retry_after
from .events import Event, events
from .files import Mesh, form, output_of, outputs_of, receive, save
from .options import Options
from .patience import Patience

SERVER = "http://127.0.0.1:8080"
FINAL = ("succeeded", "failed", "canceled", "expired")
# The longest that the service holds a request for, and the longest silence in a stream: three of its signs of life.
WAIT_SECONDS_MAX = 60
SILENCE_SECONDS_MAX = 45.0
# How long to try where no service has ever answered.
STRANGER_PATIENCE_SECONDS = 2.0
# How often a batch is looked at.
BATCH_LOOK_SECONDS = 1.0

Paths = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]


class Readable(Protocol):
    """A generated type."""

    @classmethod
    def from_dict(cls, src_dict: Mapping[str, Any]) -> Self: ...


Answer = TypeVar("Answer", bound=Readable)
Received = TypeVar("Received")


def rig(mesh: Mesh | Asset, out: Paths | None = None, *, server: str | None = None, key: str | None = None,
        beside: Sequence[str | os.PathLike[str]] = (), **options: Unpack[Options]) -> Rig:  # fmt: skip
    """Rigs a mesh and waits for it. `out` names the files to be written; their endings say what is to be made.

    `server` and `key` are those of `Client`, `beside` and `options` those of `Client.submit`. Raises RigsmithError.
    """
    with Client(server, key) as client:
        return client.rig(mesh, out, beside=beside, **options)


class Client:
    """A service, by its address and the key for it.

    Without arguments, `RIGSMITH_SERVER` and `RIGSMITH_KEY` say which, as they do for the command line. `patience` is how many
    seconds each call goes on asking a service that is busy, or away after it has answered before. Every method raises
    RigsmithError.
    """

    def __init__(self, server: str | None = None, key: str | None = None, *, patience: float = 300.0,
                 transport: httpx.BaseTransport | None = None) -> None:  # fmt: skip
        server = server or os.environ.get("RIGSMITH_SERVER") or SERVER
        key = key or os.environ.get("RIGSMITH_KEY")
        self._patience = patience
        self._has_answered = False
        self._http = httpx.Client(
            base_url=server.rstrip("/"),
            headers={"Authorization": f"Bearer {key}"} if key else {},
            timeout=httpx.Timeout(SILENCE_SECONDS_MAX, connect=10.0, read=WAIT_SECONDS_MAX + SILENCE_SECONDS_MAX),
            transport=transport,
        )
        # For every operation that has no method here: `rigsmith.api.api.rigs.list_rigs.sync(client=client.api)`.
        self.api = api.Client(base_url=str(self._http.base_url)).set_httpx_client(self._http)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Closes the connections."""
        self._http.close()

    # ---- in one call -----------------------------------------------------------------------------------------------------

    def rig(self, mesh: Mesh | Asset, out: Paths | None = None, *, beside: Sequence[str | os.PathLike[str]] = (),
            **options: Unpack[Options]) -> Rig:  # fmt: skip
        """Rigs a mesh, waits for it, and writes the files that `out` names. Raises RigFailed where there is no result."""
        paths = paths_of(out)
        if paths:
            options.setdefault("outputs", outputs_of(paths))  # type: ignore[typeddict-item]
        made = self.wait(self.submit(mesh, beside=beside, **options))
        for path in paths:
            self.download(made, output_of(path)[1], path)
        return made

    def skin(self, mesh: Mesh | Asset, skeleton: str | os.PathLike[str] | Mapping[str, Any], /, out: Paths | None = None, *,
             beside: Sequence[str | os.PathLike[str]] = (), **options: Unpack[Options]) -> Rig:  # fmt: skip
        """`rig` with weights alone: for a skeleton of yours, a `rig.json` or what one holds, which stays as it is."""
        text = json.dumps(skeleton) if isinstance(skeleton, Mapping) else Path(skeleton).read_text(encoding="utf-8")
        options["skeleton"] = text
        return self.rig(mesh, out, beside=beside, **options)

    # ---- step by step ----------------------------------------------------------------------------------------------------

    def upload(self, mesh: Mesh, *, beside: Sequence[str | os.PathLike[str]] = ()) -> Asset:
        """Keeps a mesh and the files `beside` it, to be rigged more than once. The same files are the same asset."""
        return self._read(Asset, self._send("POST", "/v1/assets", files=form(mesh, beside)))

    def check(self, mesh: Mesh | Asset, *, beside: Sequence[str | os.PathLike[str]] = (), **options: Unpack[Options]) -> Check:
        """What would be rigged, and what is wrong with the file. No rig is made."""
        return self._read(Check, self._send("POST", "/v1/rigs:check", **content(mesh, beside, options)))

    def submit(self, mesh: Mesh | Asset, *, beside: Sequence[str | os.PathLike[str]] = (), idempotency_key: str | None = None,
               fresh: bool = False, **options: Unpack[Options]) -> Rig:  # fmt: skip
        """Orders a rig, and does not wait for it.

        `beside` are the files that the mesh refers to: buffers, materials, textures. The same request with the same
        `idempotency_key` is the same rig, for 24 hours; without one, each call is a request of its own, sent until it is
        answered. `fresh`: do the work even if an equal rig was made before.
        """
        fields = {"Idempotency-Key": idempotency_key or uuid.uuid4().hex}
        if fresh:
            fields["Cache-Control"] = "no-cache"
        return self._read(Rig, self._send("POST", "/v1/rigs", headers=fields, **content(mesh, beside, options)))

    def get(self, rig: Rig | str) -> Rig:
        """The rig as it now is."""
        return self._read(Rig, self._send("GET", f"/v1/rigs/{name_of(rig)}"))

    def wait(self, rig: Rig | str, timeout: float | None = None) -> Rig:
        """The rig once it has a result. Raises RigFailed where there will be none, NotFinished after `timeout` seconds."""
        until = None if timeout is None else time.monotonic() + timeout
        while True:
            left = WAIT_SECONDS_MAX if until is None else min(WAIT_SECONDS_MAX, max(0, int(until - time.monotonic())))
            answer = self._send("GET", f"/v1/rigs/{name_of(rig)}", headers={"Prefer": f"wait={left}"})
            found = self._read(Rig, answer)
            if found.state in FINAL:
                return succeeded(found)
            pause = retry_after(answer) or 0.0
            if until is not None and time.monotonic() + pause > until:
                raise NotFinished(f"{found.id} is {found.state.value} after {timeout} s; wait for it again, or cancel it")
            time.sleep(pause)

    def watch(self, rig: Rig | str) -> Iterator[Event]:
        """What happens to a rig, as it happens, to its end. A stream that breaks is taken up where it was."""
        path = f"/v1/rigs/{name_of(rig)}/events"
        last: str | None = None
        patience = self._new_patience()
        while True:
            try:
                with self._http.stream(
                    "GET", path, headers={"Last-Event-ID": last} if last else {}, timeout=SILENCE_SECONDS_MAX
                ) as answer:
                    if not answer.is_success:
                        answer.read()
                        raise refusal(answer)
                    for event in events(answer.iter_lines()):
                        self._has_answered, last, patience = True, event.id, self._new_patience()
                        yield event
                        if event.name == "done":
                            return
                if answer.status_code == httpx.codes.NO_CONTENT:
                    return
                broken: Exception | None = None
            except httpx.TransportError as error:
                broken = error
            if not patience.pause():
                raise Unreachable(f"{self._http.base_url}: the events of {name_of(rig)} broke off") from broken

    def read(self, rig: Rig | str, name: str) -> bytes:
        """A file that was made, such as `rig.json`; its digest is looked at."""

        def receive_all(answer: httpx.Response) -> bytes:
            file = io.BytesIO()
            receive(answer, file)
            return file.getvalue()

        return self._download(rig, name, receive_all)

    def download(self, rig: Rig | str, name: str, to: str | os.PathLike[str]) -> Path:
        """Writes a file that was made to `to`, whole or not at all; its digest is looked at."""
        path = Path(to)
        self._download(rig, name, lambda answer: save(answer, path))
        return path

    def cancel(self, rig: Rig | str) -> Rig:
        """Ends a rig that waits, or asks a running one to end."""
        return self._read(Rig, self._send("POST", f"/v1/rigs/{name_of(rig)}:cancel"))

    def delete(self, rig: Rig | str) -> None:
        """Forgets a rig and its files."""
        self._send("DELETE", f"/v1/rigs/{name_of(rig)}")

    # ---- many at once ----------------------------------------------------------------------------------------------------

    def batch(
        self, meshes: Mapping[str, Mesh | Asset], *, timeout: float | None = None, **options: Unpack[Options]
    ) -> list[BatchResult]:
        """Rigs many meshes behind everything else that the service does, and waits for all of them.

        The results come in the order of `meshes`, each under its name there (`custom_id`) with its `rig` or with the `error`
        why there is none: one bad mesh never fails the others. `options` are those of every mesh. Raises NotFinished after
        `timeout` seconds.
        """
        refused: dict[str, BatchResult] = {}
        lines = []
        for name, mesh in meshes.items():
            try:
                asset = mesh if isinstance(mesh, Asset) else self.upload(mesh)
            except InvalidRequest as error:
                refused[name] = BatchResult.from_dict({"custom_id": name, "error": told(error)})
            else:
                lines.append(json.dumps({"custom_id": name, "request": {"asset": asset.id, **options}}))
        made = {result.custom_id: result for result in self._batch(lines, timeout)} if lines else {}
        return [refused.get(name) or made[name] for name in meshes]

    def _batch(self, lines: Sequence[str], timeout: float | None) -> list[BatchResult]:
        fields = {"Content-Type": "application/jsonl", "Idempotency-Key": uuid.uuid4().hex}
        batch = self._read(Batch, self._send("POST", "/v1/batches", headers=fields, content="\n".join(lines).encode()))
        patience = Patience(float("inf") if timeout is None else timeout)
        while batch.finished_at is None:
            if not patience.pause(BATCH_LOOK_SECONDS):
                raise NotFinished(f"{batch.id} is {batch.state} after {timeout} s; `api` waits for it again, or cancels it")
            batch = self._read(Batch, self._send("GET", f"/v1/batches/{batch.id}"))
        results = self._send("GET", f"/v1/batches/{batch.id}/results")
        return [parsed(BatchResult, json.loads(line), results) for line in results.text.splitlines()]

    # ---- asking ------------------------------------------------------------------------------------------------------------

    def _new_patience(self) -> Patience:
        return Patience(self._patience if self._has_answered else min(self._patience, STRANGER_PATIENCE_SECONDS))

    def _send(self, method: str, path: str, **content: Any) -> httpx.Response:
        """The answer to a request that may be sent twice."""
        patience = self._new_patience()
        while True:
            try:
                answer = self._http.request(method, path, **content)
            except httpx.TransportError as error:
                if not patience.pause():
                    raise Unreachable(f"{self._http.base_url} does not answer: {error}") from error
                continue
            if not self._has_answered:
                self._has_answered, patience = True, Patience(self._patience)
            if answer.is_success:
                return answer
            refused = refusal(answer)
            busy = isinstance(refused, Refused) and refused.retryable and refused.retry_after is not None
            if not (busy and patience.pause(retry_after(answer))):
                raise refused

    def _download(self, rig: Rig | str, name: str, take: Callable[[httpx.Response], Received]) -> Received:
        path = f"/v1/rigs/{name_of(rig)}/artifacts/{segment(name)}"
        patience = self._new_patience()
        while True:
            try:
                with self._http.stream("GET", path) as answer:
                    if answer.is_success:
                        return take(answer)
                    answer.read()
                    raise refusal(answer)
            except (httpx.TransportError, Broken) as error:
                if not patience.pause():
                    raise error if isinstance(error, Broken) else Unreachable(f"{self._http.base_url}: {error}") from error

    def _read(self, kind: type[Answer], answer: httpx.Response) -> Answer:
        try:
            told = answer.json()
        except ValueError as error:
            raise NotUnderstood(f"{answer.request.url} did not answer with JSON") from error
        return parsed(kind, told, answer)


def parsed(kind: type[Answer], told: Any, answer: httpx.Response) -> Answer:
    """What `answer` tells, as a generated type. Raises NotUnderstood."""
    try:
        return kind.from_dict(told)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise NotUnderstood(f"{answer.request.url} answered with no {kind.__name__} of this version: {error!r}") from error


def content(mesh: Mesh | Asset, beside: Sequence[str | os.PathLike[str]], options: Options) -> dict[str, Any]:
    """The body of a request: JSON that names an asset, or a form."""
    if isinstance(mesh, Asset):
        if beside:
            raise ValueError("files beside a mesh are uploaded with it: give them to upload")
        return {"json": {"asset": mesh.id, **options}}
    return {"files": form(mesh, beside), "data": {"options": json.dumps(options)}}


def paths_of(out: Paths | None) -> list[Path]:
    """The files that are to be written."""
    if out is None:
        return []
    return [Path(out)] if isinstance(out, str | os.PathLike) else [Path(path) for path in out]


def succeeded(rig: Rig) -> Rig:
    """`rig`, whose work is over. Raises RigFailed where it has no result."""
    if rig.state != "succeeded":
        raise RigFailed(rig.id, rig.state.value, rig.error.to_dict() if rig.error else {})
    return rig


def told(error: Refused) -> dict[str, Any]:
    """A refusal as the error of an item."""
    return {
        "code": error.code, "stage": error.stage, "message": error.detail, "hint": error.hint, "retryable": error.retryable,
        "type": f"/v1/problems/{error.code}",
    }  # fmt: skip


def name_of(rig: Rig | str) -> str:
    """The id of a rig, as one segment of a path."""
    return segment(rig.id if isinstance(rig, Rig) else rig)


def segment(name: str) -> str:
    """`name`, which is one segment of a path. Raises ValueError for what is none."""
    if not name.strip(".") or not all(letter.isascii() and (letter.isalnum() or letter in ".-_") for letter in name):
        raise ValueError(f"{name!r} is the name neither of a rig nor of its files")
    return name
