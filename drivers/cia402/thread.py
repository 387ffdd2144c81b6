"""The single thread that runs a machine's blocking exchanges, so that they never overlap on the bus."""

import asyncio
from collections.abc import Callable, Coroutine
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import ParamSpec, TypeVar

from drivers.errors import CommunicationLost

P = ParamSpec("P")
T = TypeVar("T")


class DriveThread:
    """First come, first served. If a caller is cancelled, its call, once started, still runs to its end."""

    def __init__(self, name: str) -> None:
        self._executor = ThreadPoolExecutor(1, thread_name_prefix=name)
        self._closed = False

    async def run(self, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """The result of `function`, called on the thread. Raises CommunicationLost after `close`."""
        if self._closed:
            raise CommunicationLost("the connection was closed")
        return await asyncio.wrap_future(self._executor.submit(function, *args, **kwargs))

    def post(self, function: Callable[P, object], *args: P.args, **kwargs: P.kwargs) -> None:
        """Call `function` on the thread without waiting for it. Does nothing after `close`."""
        with suppress(RuntimeError):  # closed this moment
            self._executor.submit(function, *args, **kwargs)

    async def close(self) -> None:
        """Ends the thread after the calls that are queued; on a closed bus they fail at once."""
        self._closed = True
        await asyncio.to_thread(self._executor.shutdown)


async def to_the_end(work: Coroutine[object, object, None]) -> None:
    """Runs code that releases a bus to its end, even if the caller is cancelled twice."""
    task = asyncio.create_task(work, name="release the bus")
    while not task.done():
        with suppress(asyncio.CancelledError):
            await asyncio.wait([task])
    task.result()
