"""What can go wrong, by who must act."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import httpx


class RigsmithError(Exception):
    """Whatever this package raises on its own account."""


class Unreachable(RigsmithError):
    """No service answers at the address, or the connection broke again and again."""


class NotUnderstood(RigsmithError):
    """An answer that this client cannot read: no Rigsmith service, or one of another version."""


class NotFinished(RigsmithError, TimeoutError):
    """The work was not over in the time given. It goes on at the service."""


class Broken(RigsmithError):
    """The bytes that came are not those that were made."""


@dataclass(frozen=True)
class FieldError:
    """Why one field of a request was refused."""

    field: str
    code: str
    detail: str


class Refused(RigsmithError):
    """The service refused a request (RFC 9457). `code` is stable; `GET /v1/problems/{code}` explains it."""

    def __init__(self, status: int, problem: Mapping[str, Any], retry_after: float | None) -> None:
        self.status = status
        self.code = str(problem.get("code", ""))
        self.title = str(problem.get("title", ""))
        self.detail = str(problem.get("detail", ""))
        # The next step.
        self.hint: str | None = problem.get("hint")
        # Names the request in the log of the service.
        self.request_id: str | None = problem.get("request_id")
        self.stage: str | None = problem.get("stage")
        # Whether the same request may succeed later, unchanged,
        self.retryable = bool(problem.get("retryable"))
        # and after how many seconds to try.
        self.retry_after = retry_after
        self.errors = [
            FieldError(str(error.get("field", "")), str(error.get("code", "")), str(error.get("detail", "")))
            for error in problem.get("errors", [])
        ]
        # The limit that was passed: `name`, `max`, and where it is known `actual`.
        self.limit: Mapping[str, Any] | None = problem.get("limit")
        super().__init__(sentence(self.code, self.detail, self.hint))


class InvalidRequest(Refused):
    """The request or the file is wrong; the same again is refused again."""


class Forbidden(Refused):
    """The service asks for a key, and this is none of its keys."""


class NotFound(Refused):
    """There is no such thing, or it is not yours."""


class Expired(NotFound):
    """It was there once; its files are no longer kept."""


class Conflict(Refused):
    """The thing is in a state in which this cannot be done."""


class TooLarge(InvalidRequest):
    """The upload passes a limit; `limit` says which."""


class Busy(Refused):
    """The service takes no more now, and did not for as long as the client was told to be patient."""


class ServiceFault(Refused):
    """The fault is the service's; its operator finds `request_id` in the log."""


class RigFailed(RigsmithError):
    """A rig ended without a result: it failed, was canceled, or its files are no longer kept."""

    def __init__(self, rig_id: str, state: str, error: Mapping[str, Any]) -> None:
        self.rig_id = rig_id
        self.state = state
        self.code = str(error.get("code") or state)
        self.detail = str(error.get("message") or f"{rig_id} is {state}")
        self.hint: str | None = error.get("hint")
        self.stage: str | None = error.get("stage")
        self.retryable = bool(error.get("retryable"))
        super().__init__(sentence(self.code, self.detail, self.hint))


def sentence(code: str, detail: str, hint: str | None) -> str:
    """One line for whoever reads a traceback."""
    return f"{code}: {detail}" + (f" ({hint})" if hint else "")


KINDS: dict[int, type[Refused]] = {
    401: Forbidden, 403: Forbidden, 404: NotFound, 409: Conflict, 410: Expired, 413: TooLarge, 429: Busy, 503: Busy,
}  # fmt: skip


def refusal(answer: httpx.Response) -> RigsmithError:
    """The exception for an answer that is no success."""
    try:
        problem = answer.json()
    except ValueError:
        problem = None
    if not isinstance(problem, dict) or "code" not in problem:
        return NotUnderstood(
            f"{answer.request.url} answered {answer.status_code} with no problem that a Rigsmith service would tell"
        )
    fallback = ServiceFault if answer.status_code >= 500 else InvalidRequest
    kind = KINDS.get(answer.status_code, fallback)
    return kind(answer.status_code, problem, retry_after(answer))


def retry_after(answer: httpx.Response) -> float | None:
    """Seconds after which the service wants to be asked again."""
    told = answer.headers.get("retry-after", "")
    return float(told) if told.isdecimal() else None
