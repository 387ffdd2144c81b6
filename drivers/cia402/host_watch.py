"""Whether this host may move its axes: it was here without a gap, and alone. The gate before each word of motion.

A process that was halted or a computer that slept knows nothing of it when it goes on; its drives have stopped by their
own watchdog meanwhile. So the event loop, on which the heartbeat depends, shows life, and who is about to close a loop
or to move an axis looks first how long ago that was: whichever thread wakes first finds the gap, before it sends.

What was found stays until a person's word (`allow`). The one frame that a thread had in its hand, between this look and
the system call, may still go out; no drive takes energy by a single controlword.
"""

import threading
import time
from collections.abc import Callable

from drivers.errors import MotionForbidden

_BEATS = 10  # signs of life in the time allowed


def _clock() -> float:
    """s, the time in which the computer slept included, where the platform counts that (Linux)."""
    return time.clock_gettime(time.CLOCK_BOOTTIME) if hasattr(time, "CLOCK_BOOTTIME") else time.monotonic()


class HostWatch:
    """Every method may be called from any thread."""

    def __init__(self, limit: float) -> None:
        """`limit`: s without a sign of life of ours after which the drives stop by themselves."""
        self.beat = limit / _BEATS
        """Time between two signs of life, s."""
        self._limit = limit
        self._tell: Callable[[str], None] | None = None
        self._alive: float | None = None  # last sign of life; None before the first
        self._woke = float("-inf")
        self._reason = ""
        self._lock = threading.Lock()

    @property
    def reason(self) -> str:
        """Why nothing may be energised or moved; "" if nothing forbids it. Notices a gap."""
        self.look()
        return self._reason

    @property
    def woke(self) -> float:
        """End of the last gap, s on the monotonic clock: nobody was heard before that because nobody listened."""
        self.look()
        return self._woke

    def tell_to(self, tell: Callable[[str], None] | None) -> None:
        """`tell` is given what is found, on the thread that finds it, once until `allow`; at once what was found."""
        self._tell = tell
        if self._reason and tell is not None:
            tell(self._reason)

    def check(self) -> None:
        """MotionForbidden if anything was found."""
        if reason := self.reason:
            raise MotionForbidden(reason)

    def alive(self) -> None:
        """A sign of life of the event loop. The first one begins the watch over gaps."""
        self.look(alive=True)

    def seen(self, what: str) -> None:
        """Another host, or what only another can have done."""
        with self._lock:
            first = self._note(what)
        self._pass_on(what, first)

    def allow(self) -> None:
        """A person looked. What is found from here on is told again."""
        with self._lock:
            self._reason = ""

    def look(self, *, alive: bool = False) -> None:
        """Notices a gap."""
        what, first = "", False
        with self._lock:
            now = _clock()
            gap = 0.0 if self._alive is None else now - self._alive
            if gap > self._limit:
                self._woke = time.monotonic()
                what = f"the host was suspended for {gap:.1f} s, its drives wait for {self._limit:g} s"
                first = self._note(what)
            if alive or gap > self._limit:
                self._alive = now
        self._pass_on(what, first)

    def _note(self, what: str) -> bool:
        """Whether it is the first that was found; with the lock held."""
        if self._reason:
            return False
        self._reason = what
        return True

    def _pass_on(self, what: str, first: bool) -> None:
        tell = self._tell
        if first and tell is not None:
            tell(what)
