"""The single thread that runs a machine's blocking exchanges, so that they never overlap on the bus."""

import asyncio
from collections import deque
from collections.abc import Callable, Coroutine
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from typing import ParamSpec, TypeVar

from drivers.errors import CauseCode, CommunicationLost, DriveError

P = ParamSpec("P")
T = TypeVar("T")


class StopFirst(DriveError, code=CauseCode.SWEEP_INTERRUPTED):
    """A stop waits while a call uses the bus. The call ends by this, and begins again once the stop was sent."""


class DriveThread:
    """First come, first served, except for `post`. If a caller is cancelled, its call, once started, still runs to its
    end.
    """

    def __init__(self, name: str) -> None:
        self._executor = ThreadPoolExecutor(1, thread_name_prefix=name)
        self._closed = False
        self._posted: deque[Callable[[], object]] = deque()

    async def run(self, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """The result of `function`, called on the thread. Raises CommunicationLost after `close`."""
        if self._closed:
            raise CommunicationLost("the connection was closed")
        return await asyncio.wrap_future(self._executor.submit(self._call, partial(function, *args, **kwargs)))

    def post(self, function: Callable[P, object], *args: P.args, **kwargs: P.kwargs) -> None:
        """Call `function` on the thread without waiting for it, before everything that has not begun. Does nothing
        after `close`.
        """
        self._posted.append(partial(function, *args, **kwargs))
        with suppress(RuntimeError):  # closed this moment
            self._executor.submit(self._call_posted)

    async def close(self) -> None:
        """Ends the thread after the calls that are queued; on a closed bus they fail at once."""
        self._closed = True
        await asyncio.to_thread(self._executor.shutdown)

    def _call(self, function: Callable[[], T]) -> T:
        """A call that a stop interrupted begins again. That moves nothing: whoever sends a stop marks the motion as
        stopped first, and every call that energises or moves checks this mark before its first command.
        """
        while True:
            self._call_posted()
            with suppress(StopFirst):
                return function()

    def _call_posted(self) -> None:
        while self._posted:
            self._posted.popleft()()


async def to_the_end(work: Coroutine[object, object, None]) -> None:
    """Runs code that releases a bus to its end, even if the caller is cancelled twice."""
    task = asyncio.create_task(work, name="release the bus")
    while not task.done():
        with suppress(asyncio.CancelledError):
            await asyncio.wait([task])
    task.result()
