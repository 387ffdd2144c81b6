"""Questions to the drives for the statement of the machine: one at a time for any number of callers."""

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress

from drivers.errors import DriveError
from service.model.errors import Conflict
from service.process.tasks.background import Background

ASKING = 0.5  # s that a caller waits for the answers


class Asking:
    """`read` asks the drives; what they answer is noted there."""

    def __init__(self, read: Callable[[], Awaitable[object]]) -> None:
        self._read = read
        self._background = Background()
        self._done: asyncio.Event | None = None

    async def ask(self) -> None:
        """Returns when the drives have answered, or after `ASKING` s. Never raises."""
        if self._done is None:
            self._done = asyncio.Event()
            self._background.begin("ask the drives", self._refresh(self._done))
        with suppress(TimeoutError):
            await asyncio.wait_for(self._done.wait(), ASKING)

    async def close(self) -> None:
        await self._background.settle()

    async def _refresh(self, done: asyncio.Event) -> None:
        try:
            with suppress(DriveError, Conflict):  # the statement tells it
                await self._read()
        finally:
            self._done = None
            done.set()
