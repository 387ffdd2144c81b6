"""The sign of life of an operator: if the start of a campaign requires it, the axes stop when it is missing."""

import asyncio
from collections.abc import Callable

from drivers.errors import Cause, CauseCode


class SignOfLife:
    """For one run of a campaign, on the event loop. `missed` is called once, with the cause, unless `end` is called
    before.
    """

    def __init__(self, within: float, missed: Callable[[Cause], None]) -> None:
        """`within`: maximum time between two signs of life, s; the first one is the start."""
        self.within = within
        self._missed = missed
        self._loop = asyncio.get_running_loop()
        self._timer = self._set()

    @property
    def left(self) -> float:
        """s until a sign of life is missed."""
        return max(0.0, self._timer.when() - self._loop.time())

    def renew(self) -> None:
        self._timer.cancel()
        self._timer = self._set()

    def end(self) -> None:
        self._timer.cancel()

    def _set(self) -> asyncio.TimerHandle:
        why = (
            f"no sign of life within {self.within:g} s, which the start of this run requires: no "
            "person monitors the machine"
        )
        cause = Cause(CauseCode.SIGN_OF_LIFE, limit=self.within, unit="s", detail=why)
        return self._loop.call_later(self.within, self._missed, cause)
