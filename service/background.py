"""Work on the event loop that nobody waits for, and work that must end although its caller is cancelled."""

import asyncio
from collections.abc import Awaitable, Coroutine
from typing import TypeVar

import structlog

_log = structlog.get_logger(__name__)

Result = TypeVar("Result")


class Background:
    """The tasks of one owner. Whoever makes one closes or settles it: no task outlives its owner."""

    def __init__(self) -> None:
        self._tasks: set[asyncio.Task[None]] = set()

    def begin(self, name: str, work: Coroutine[object, object, None]) -> None:
        """Run `work` in a task of that name; an error that ends it is logged."""
        task = asyncio.create_task(work, name=name)
        self._tasks.add(task)
        task.add_done_callback(self._ended)

    async def settle(self) -> None:
        """Wait for all of them."""
        if self._tasks:
            await asyncio.wait(tuple(self._tasks))

    async def close(self) -> None:
        """Cancel all of them and wait for their ends."""
        for task in tuple(self._tasks):
            task.cancel()
        await self.settle()

    def _ended(self, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            _log.error("task_failed", task=task.get_name(), exc_info=error)


async def to_its_end(work: Awaitable[Result]) -> Result:
    """The result of `work`, which ends in any case: a caller that is cancelled hears of it afterwards.

    An error of `work` is then logged, for the cancellation is what the caller gets.
    """
    task = asyncio.ensure_future(work)
    cancelled: asyncio.CancelledError | None = None
    while not task.done():
        try:
            await asyncio.wait([task])
        except asyncio.CancelledError as error:
            cancelled = error
    if cancelled is None:
        return task.result()
    if not task.cancelled() and (error := task.exception()) is not None:
        _log.error("failed_while_cancelled", reason=str(error), exc_info=error)
    raise cancelled
