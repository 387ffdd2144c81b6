"""The one thread on which a machine's blocking exchanges run, so that no two of them ever meet on the bus."""

import asyncio
from collections.abc import Callable, Coroutine
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import ParamSpec, TypeVar

from drivers.errors import CommunicationLost

P = ParamSpec("P")
T = TypeVar("T")


class DriveThread:
    """First come, first served. A cancelled caller leaves; its call, once begun, runs to its end all the same."""

    def __init__(self, name: str) -> None:
        self._executor = ThreadPoolExecutor(1, thread_name_prefix=name)
        self._closed = False

    async def run(self, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """The result of `function`, called on the thread. CommunicationLost after `close`."""
        if self._closed:
            raise CommunicationLost("the connection was closed")
        return await asyncio.wrap_future(self._executor.submit(function, *args, **kwargs))

    def post(self, function: Callable[P, object], *args: P.args, **kwargs: P.kwargs) -> None:
        """Have `function` called on the thread; nobody waits for it. Nothing after `close`."""
        with suppress(RuntimeError):  # closed this moment
            self._executor.submit(function, *args, **kwargs)

    async def close(self) -> None:
        """Ends the thread after the calls that wait for it: on a bus that is closed they fail at once."""
        self._closed = True
        await asyncio.to_thread(self._executor.shutdown)


async def to_the_end(work: Coroutine[object, object, None]) -> None:
    """Runs what releases a bus to its end, also when the caller is cancelled twice."""
    task = asyncio.create_task(work, name="release the bus")
    while not task.done():
        with suppress(asyncio.CancelledError):
            await asyncio.wait([task])
    task.result()
