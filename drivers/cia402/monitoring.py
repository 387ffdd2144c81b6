"""Monitoring while connected: polling of unused axes."""

import asyncio
import itertools
from collections.abc import Callable
from contextlib import suppress

from drivers.cia402.connection import Connection
from drivers.errors import DriveError

LOOK = 0.3  # s from the check of one axis to that of the next


async def look(link: Connection, reading: asyncio.Lock, idle: Callable[[], bool]) -> None:
    """Checks one axis after the other whether another host enabled it, until cancelled.

    `reading`: lock held while the axes are polled; `idle`: True if no motion is in progress.
    """
    for axis in itertools.cycle(link.axes.values()):
        await asyncio.sleep(LOOK)
        async with reading:
            if idle():
                with suppress(DriveError):  # the next caller gets the error
                    await link.thread.run(axis.check_unused)
