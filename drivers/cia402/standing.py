"""The axes that stand beside a sweep: trouble of one of them ends it, however slowly its samples are consumed."""

import asyncio
import threading
from collections.abc import AsyncGenerator, Sequence
from contextlib import asynccontextmanager

from drivers.cia402.axis import Axis
from drivers.cia402.thread import DriveThread
from drivers.errors import SweepInterrupted

POLL = 0.02  # s


@asynccontextmanager
async def watched(thread: DriveThread, standing: Sequence[Axis], stop: threading.Event) -> AsyncGenerator[None]:
    """While the block runs a sweep: trouble of an axis that stands sets `stop`, and is raised in place of the stop."""
    watch = asyncio.create_task(_watch(thread, standing, stop))
    try:
        yield
    except SweepInterrupted:
        if watch.done():
            watch.result()
        raise
    finally:
        watch.cancel()
        await asyncio.gather(watch, return_exceptions=True)


async def _watch(thread: DriveThread, standing: Sequence[Axis], stop: threading.Event) -> None:
    """Until `stop`: on the way down the others may be told all sorts of things."""
    try:
        while not stop.is_set():
            await thread.run(_check, standing)
            await asyncio.sleep(POLL)
    except Exception:  # nobody watches any more
        stop.set()
        raise


def _check(standing: Sequence[Axis]) -> None:
    for axis in standing:
        axis.check_standing()
