"""While connected: the life of the event loop, shown to the host watch, and a look at the axes that nobody uses."""

import asyncio
import itertools
from collections.abc import Callable
from contextlib import suppress

from drivers.cia402.connection import Connection
from drivers.errors import DriveError

LOOK = 0.3  # s from a look at one axis to that at the next


async def attend(link: Connection, reading: asyncio.Lock, idle: Callable[[], bool]) -> None:
    """Until cancelled. `reading`: held by who asks the axes how they are; `idle`: no motion is under way."""
    looking = asyncio.create_task(_look(link, reading, idle), name="look at the axes")
    try:
        while True:
            link.watch.alive()
            await asyncio.sleep(link.watch.beat)
    finally:
        looking.cancel()
        await asyncio.gather(looking, return_exceptions=True)


async def _look(link: Connection, reading: asyncio.Lock, idle: Callable[[], bool]) -> None:
    """One axis after the other, for one that somebody else enabled."""
    for axis in itertools.cycle(link.axes.values()):
        await asyncio.sleep(LOOK)
        async with reading:
            if idle():
                with suppress(DriveError):  # whoever asks next is told
                    await link.thread.run(axis.check_unused)
