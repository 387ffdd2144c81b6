"""Axes that stand during a sweep: a fault of one of them ends the sweep, even if its samples are read slowly."""

import asyncio
import threading
from collections.abc import Sequence

from drivers.cia402.axis import Axis
from drivers.cia402.thread import DriveThread
from drivers.errors import SweepInterrupted

POLL = 0.02  # s


class Watched:
    """Runs a sweep inside the block: an error of a standing axis sets `stop` and is raised instead of the interruption.

    Not a generator: the end of an event loop closes generators in any order.
    """

    def __init__(self, thread: DriveThread, standing: Sequence[Axis], stop: threading.Event) -> None:
        self._work = thread, standing, stop

    async def __aenter__(self) -> None:
        self._watch = asyncio.create_task(_watch(*self._work), name="standing axes")

    async def __aexit__(self, _: object, error: BaseException | None, __: object) -> None:
        over = self._watch.done() and not self._watch.cancelled()
        found = self._watch.exception() if over else None
        self._watch.cancel()
        await asyncio.gather(self._watch, return_exceptions=True)
        if found is not None and isinstance(error, SweepInterrupted):
            raise found


async def _watch(thread: DriveThread, standing: Sequence[Axis], stop: threading.Event) -> None:
    """Runs until `stop` is set. During the stop sequence the standing axes receive commands too."""
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
