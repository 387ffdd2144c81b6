"""The virtual time of a test, and what a test may do to the threads that live in it."""

import asyncio
import time
from collections.abc import Callable

from tests.virtual_time.scheduler import Process, Scheduler


class Clock:
    """Time passes only while every thread waits. `seed` is the interleaving."""

    def __init__(self, scheduler: Scheduler) -> None:
        self.scheduler = scheduler

    @property
    def now(self) -> float:
        """s; looking takes no time."""
        return self.scheduler.now

    @property
    def seed(self) -> int:
        return self.scheduler.seed

    @property
    def digest(self) -> str:
        """Of all switches and frames so far."""
        return self.scheduler.digest.hexdigest()

    def sleep(self, seconds: float) -> None:
        """The calling thread, with its event loop; the program under test runs on."""
        time.sleep(seconds)

    def suspend(self, process: Process, seconds: float) -> None:
        """As SIGSTOP and, `seconds` later, SIGCONT; a test suspends itself if the drives run in its own process."""
        self.scheduler.suspend(process, seconds)

    @property
    def own(self) -> Process:
        """The process of the test itself."""
        return self.scheduler.main.process

    async def until(
        self, condition: Callable[[], object], what: str, within: float = 60.0, step: float = 0.005
    ) -> float:
        """Wait in an async test; returns how long it took, s. AssertionError with `what` after `within` s."""
        began = self.now
        while not condition():
            assert self.now - began < within, f"{what}: not within {within} s"
            await asyncio.sleep(step)
        return self.now - began

    def wait_until(
        self, condition: Callable[[], object], what: str, within: float = 60.0, step: float = 0.005
    ) -> float:
        """As `until`, in a thread without an event loop."""
        began = self.now
        while not condition():
            assert self.now - began < within, f"{what}: not within {within} s"
            self.sleep(step)
        return self.now - began
