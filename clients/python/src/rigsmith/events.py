"""Server-sent events (HTML Living Standard, section 9.2), as far as the service uses them."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Event:
    """Something that happened to a rig."""

    # Rises from event to event.
    id: str
    # `snapshot`, `state`, `progress`, `warning`, `artifact` or `done`.
    name: str
    # The rig for `snapshot`, else what happened, and when.
    data: dict[str, Any]


def events(lines: Iterable[str]) -> Iterator[Event]:
    """The events of a stream. One that breaks off is dropped."""
    fields: dict[str, str] = {}
    for line in lines:
        if line:
            name, _, value = line.partition(":")
            fields[name] = value.removeprefix(" ")
        elif "data" in fields:
            yield Event(fields.get("id", ""), fields.get("event", "message"), json.loads(fields["data"]))
            fields.clear()
