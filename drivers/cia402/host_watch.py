"""Whether this host may move its axes: it ran without a gap and is the only host. Checked before each motion command.

A process that was suspended, or a computer that slept, does not notice this when it continues; meanwhile its drives
have stopped by their own watchdog. Therefore the event loop, on which the heartbeat depends, gives a sign of life.
CauseCode that is about to enable or move an axis first checks the age of the last sign of life: the first thread that
wakes finds the gap before it sends.

The watch begins with the process, not with the connection: a command may wait for the first connection over a gap.
A finding stays until a person confirms it (`allow`). A single frame between this check and the system call may still
be sent; no drive is energised by a single controlword.
"""

import asyncio
import threading
import time
from collections.abc import Callable

from drivers.errors import Cause, CauseCode, MotionForbidden


def _clock() -> float:
    """s, including the time in which the computer slept, if the platform counts it (Linux)."""
    return time.clock_gettime(time.CLOCK_BOOTTIME) if hasattr(time, "CLOCK_BOOTTIME") else time.monotonic()


class HostWatch:
    """All methods but `keep` may be called from any thread."""

    def __init__(self, limit: float) -> None:
        """`limit`: time without a sign of life of the host after which the drives stop by themselves, s."""
        self.beat = limit / 10
        """Time between two signs of life, s."""
        self._limit = limit
        self._tell: Callable[[Cause], None] | None = None
        self._beating: asyncio.Task[None] | None = None
        self._alive: float | None = None  # last sign of life; None before the first
        self._woke = float("-inf")
        self._finding: Cause | None = None
        self._lock = threading.Lock()

    def keep(self, wanted: bool) -> None:
        """On the event loop, which shows life from now on, at once and until it is not wanted any more."""
        if wanted and self._beating is None:
            self.alive()
            self._beating = asyncio.create_task(self._beats(), name="host watch")
        elif not wanted and self._beating is not None:
            self._beating.cancel()
            self._beating = None

    async def _beats(self) -> None:
        try:
            while True:
                await asyncio.sleep(self.beat)
                self.alive()
        finally:
            with self._lock:
                self._alive = None  # nobody shows life from now on: that is no gap

    @property
    def reason(self) -> str:
        """Why nothing may be energised or moved; "" if motion is allowed. Detects a gap."""
        self.look()
        return "" if self._finding is None else self._finding.detail

    @property
    def woke(self) -> float:
        """End of the last gap, s on the monotonic clock. Before it the host did not run, and received no node."""
        self.look()
        return self._woke

    def tell_to(self, tell: Callable[[Cause], None] | None) -> None:
        """`tell` receives each gap on the thread that detects it, any other finding once until `allow`.

        An existing finding is received at once.
        """
        self._tell = tell
        if self._finding is not None and tell is not None:
            tell(self._finding)

    def check(self) -> None:
        """Raises MotionForbidden if there is a finding."""
        self.look()
        if self._finding is not None:
            raise MotionForbidden(self._finding.detail, joint=self._finding.joint, code=self._finding.code)

    def alive(self) -> None:
        """A sign of life of the event loop. The first one starts the detection of gaps."""
        self.look(alive=True)

    def seen(self, what: str, code: CauseCode = CauseCode.OTHER_HOST, joint: str = "") -> None:
        """Report another host, or an effect that only another host can cause."""
        finding = Cause(code, joint, detail=what)
        with self._lock:
            first = self._note(finding)
        self._pass_on(finding, first)

    def allow(self) -> None:
        """A person has checked the machine. Later findings are reported again."""
        with self._lock:
            self._finding = None

    def look(self, *, alive: bool = False) -> None:
        """Detects a gap."""
        found, first = Cause(CauseCode.HOST_GAP), False
        with self._lock:
            now = _clock()
            gap = 0.0 if self._alive is None else now - self._alive
            if gap > self._limit:
                self._woke = time.monotonic()
                what = f"the host was suspended for {gap:.1f} s, limit {self._limit:g} s (time-out of its drives)"
                found = Cause(CauseCode.HOST_GAP, value=gap, limit=self._limit, unit="s", detail=what)
                self._note(found)
                first = True  # each one ends what was wanted before it, also while an earlier one is being released
            if alive or gap > self._limit:
                self._alive = now
        self._pass_on(found, first)

    def _note(self, finding: Cause) -> bool:
        """Whether this is the first finding; called with the lock held."""
        if self._finding is not None:
            return False
        self._finding = finding
        return True

    def _pass_on(self, finding: Cause, first: bool) -> None:
        tell = self._tell
        if first and tell is not None:
            tell(finding)
