"""How long to go on asking, and how long to pause between."""

from __future__ import annotations

import time

FIRST_PAUSE_SECONDS = 0.2
PAUSE_SECONDS_MAX = 5.0


class Patience:
    """Counts down from `seconds`."""

    def __init__(self, seconds: float) -> None:
        self._until = time.monotonic() + seconds
        self._pause = FIRST_PAUSE_SECONDS

    def pause(self, seconds: float | None = None) -> bool:
        """Sleeps for `seconds`; without them, twice as long each time. False, and at once, where patience would be over by then."""
        if seconds is None:
            seconds, self._pause = self._pause, min(2 * self._pause, PAUSE_SECONDS_MAX)
        if time.monotonic() + seconds > self._until:
            return False
        time.sleep(seconds)
        return True
