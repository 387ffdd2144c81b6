"""The stop sequence for any number of stops: few run at a time, and a stop never shares one that began before it."""

import asyncio
from contextlib import suppress

from drivers.errors import DriveError
from drivers.ports import DrivePort

AT_ONCE = 2  # a second one does not wait for the first, whose drives may be silent


class StopSequences:
    """The calls of `DrivePort.stop` of one machine."""

    def __init__(self, port: DrivePort) -> None:
        self._port = port
        self._running: set[asyncio.Task[tuple[str, ...]]] = set()
        self._next: asyncio.Task[tuple[str, ...]] | None = None  # not begun yet

    async def confirmed(self) -> tuple[str, ...]:
        """The result of a sequence that begins after this call. Errors as `DrivePort.stop`. Safe to cancel."""
        if self._next is None:
            self._next = asyncio.create_task(self._begin(), name="stop sequence")
            self._next.add_done_callback(_retrieved)
        return await asyncio.shield(self._next)

    async def close(self) -> None:
        """Wait for the ends of all of them."""
        while tasks := [*self._running, *(() if self._next is None else (self._next,))]:
            await asyncio.wait(tasks)

    async def _begin(self) -> tuple[str, ...]:
        while len(self._running) >= AT_ONCE:
            await asyncio.wait(self._running, return_when=asyncio.FIRST_COMPLETED)
        task, self._next = self._next, None
        if task is not None:
            self._running.add(task)
            task.add_done_callback(self._running.discard)
        return await self._port.stop()


def _retrieved(task: "asyncio.Task[tuple[str, ...]]") -> None:
    """Its error is for those who wait; they may have been cancelled."""
    with suppress(asyncio.CancelledError, DriveError):
        task.result()
