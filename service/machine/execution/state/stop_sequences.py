"""The stop sequence for any number of stops: few run at a time, and a stop never shares one that began before it."""

import asyncio
import time
from collections.abc import Awaitable, Coroutine
from contextlib import suppress
from typing import Protocol, TypeVar

import structlog

from drivers.errors import DriveError, StopNotConfirmed
from service.machine.execution.state.latched_stops import Hold
from service.process.tasks.background import Background

_log = structlog.get_logger(__name__)

Result = TypeVar("Result")

CONFIRMED_WITHIN = 1.0  # s that a stop waits for its confirmation
HALTED = 0.02  # s after a stop in which its repetition sends nothing: a flood must not fill the bus
AT_ONCE = 2  # a second one does not wait for the first, whose drives may be silent


class Stops(Protocol):
    """Of `drivers.ports.DrivePort` what stops, and nothing that moves."""

    @property
    def joints(self) -> tuple[str, ...]: ...

    def halt(self) -> None: ...

    async def stop(self) -> tuple[str, ...]: ...


class StopSequences:
    """The calls of `DrivePort.halt` and `stop` of one machine."""

    def __init__(self, port: Stops) -> None:
        self._port = port
        self._running: set[asyncio.Task[tuple[str, ...]]] = set()
        self._next: asyncio.Task[tuple[str, ...]] | None = None  # not begun yet
        self._halted = float("-inf")  # time of the last stop that was sent, s on the monotonic clock
        self._background = Background()

    def halt(self, hold: Hold) -> None:
        """Send the stop to every axis, unless a repeated one was sent this moment. From any thread."""
        now = time.monotonic()
        if not hold.repeated or now - self._halted > HALTED:
            self._port.halt()
            self._halted = now

    async def within(self, hold: Hold, confirming: Coroutine[object, object, Result], limit: float) -> Result:
        """The result of `confirming`, or StopNotConfirmed after `limit` s; then it goes on, and its error is logged."""
        task = asyncio.create_task(confirming, name="confirm a stop")
        await asyncio.wait([task], timeout=limit)
        if task.done():
            return task.result()
        self._background.begin("confirm a stop", self.logged(hold, task))
        raise StopNotConfirmed((), dict.fromkeys(self._port.joints, f"did not confirm it within {limit:g} s"))

    async def logged(self, hold: Hold, confirming: Awaitable[object]) -> None:
        """For a stop whose caller does not wait for its outcome."""
        try:
            await confirming
        except DriveError as error:
            _log.error("stop_not_confirmed", by=hold.document.by, reason=str(error))

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
        await self._background.settle()

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
