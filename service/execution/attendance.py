"""An operator's sign of life: who starts a campaign may promise that somebody is there; the axes stop if nobody is."""

import asyncio
from collections.abc import Callable


class Attendance:
    """Of one run of a campaign, for the event loop. `missed` is called once, with the cause, unless `end` is before."""

    def __init__(self, within: float, missed: Callable[[str], None]) -> None:
        """`within`: s from one sign of life to the next; the first one is the start."""
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
        cause = (
            f"no sign of life for {self.within:g} s, as the start of this run wanted it: nobody looks after the machine"
        )
        return self._loop.call_later(self.within, self._missed, cause)
