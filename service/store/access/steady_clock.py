"""Time for sessions and keys: it never runs backward, whatever the computer's clock is set to.

It is the wall clock while that runs forward. When the clock is set back, it runs on from where it was, by the monotonic
clock; over a restart, from the time that the database keeps. So nothing that has expired is valid again, and what was
issued while the clock was ahead keeps its limit from then on.
"""

import threading
import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta

SET_BACK = timedelta(seconds=60)  # a clock may differ by so much from that of another service, or of the last run


def _wall() -> datetime:
    return datetime.now(UTC)


class SteadyClock:
    """Of one process; usable from any thread."""

    def __init__(self, wall: Callable[[], datetime] = _wall, monotonic: Callable[[], float] = time.monotonic) -> None:
        self.wall, self._monotonic = wall, monotonic
        self._lock = threading.Lock()
        self._at, self._since = wall(), monotonic()

    def now(self, kept: datetime | None = None) -> datetime:
        """`kept`: the time that the database keeps; this one is never before it."""
        with self._lock:
            since = self._monotonic()
            elapsed = self._at + timedelta(seconds=since - self._since)
            self._at, self._since = max(self.wall(), elapsed, kept or elapsed), since
            return self._at
