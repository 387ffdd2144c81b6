"""Monitoring while connected: sign of life of the event loop for the host watch, and polling of unused axes."""

import asyncio
import itertools
from collections.abc import Callable
from contextlib import suppress

from drivers.cia402.connection import Connection
from drivers.errors import DriveError

LOOK = 0.3  # s from the check of one axis to that of the next


async def attend(link: Connection, reading: asyncio.Lock, idle: Callable[[], bool]) -> None:
    """Runs until cancelled. `reading`: lock held while the axes are polled; `idle`: True if no motion is in
    progress.
    """
    looking = asyncio.create_task(_look(link, reading, idle), name="look at the axes")
    try:
        while True:
            link.watch.alive()
            await asyncio.sleep(link.watch.beat)
    finally:
        looking.cancel()
        await asyncio.gather(looking, return_exceptions=True)


async def _look(link: Connection, reading: asyncio.Lock, idle: Callable[[], bool]) -> None:
    """Checks one axis after the other whether another host enabled it."""
    for axis in itertools.cycle(link.axes.values()):
        await asyncio.sleep(LOOK)
        async with reading:
            if idle():
                with suppress(DriveError):  # the next caller gets the error
                    await link.thread.run(axis.check_unused)
