"""The one thread on which a machine's blocking exchanges run, so that no two of them ever meet on the bus."""

import asyncio
from collections.abc import Callable, Coroutine
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")


class DriveThread:
    """First come, first served. A cancelled caller leaves; its call runs to its end all the same."""

    def __init__(self, name: str) -> None:
        self._executor = ThreadPoolExecutor(1, thread_name_prefix=name)

    async def run(self, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """The result of `function`, called on the thread."""
        return await asyncio.wrap_future(self._executor.submit(function, *args, **kwargs))

    async def close(self) -> None:
        """Ends the thread after the call under way; calls not yet begun are dropped."""
        await asyncio.to_thread(self._executor.shutdown, cancel_futures=True)


async def to_the_end(work: Coroutine[object, object, None]) -> None:
    """Runs what releases a bus to its end, also when the caller is cancelled twice."""
    task = asyncio.create_task(work)
    while not task.done():
        with suppress(asyncio.CancelledError):
            await asyncio.wait([task])
    task.result()
