"""The campaign and sweep of a line of the log.

A task, and each thread it starts, has both in its context (`structlog.contextvars`). A line from another source, such
as the thread that receives frames, gets the present campaign and sweep of the machine of this process.
"""

import asyncio
import contextvars
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from functools import partial
from typing import ParamSpec, TypeVar

from structlog.contextvars import bound_contextvars, get_contextvars
from structlog.typing import EventDict, WrappedLogger

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")

CAMPAIGN, SWEEP = "campaign", "sweep"


class MachineWork:
    """The present work of the machine. One instance per process: a process has one machine, and one log."""

    def __init__(self) -> None:
        self._fields: Mapping[str, object] = {}  # replaced as a whole, because other threads read it

    @contextmanager
    def campaign(self, number: int) -> Generator[None]:
        """The machine works for this campaign."""
        with self._bound({CAMPAIGN: number}):
            yield

    @contextmanager
    def sweeps(self, campaign: int, numbers: Sequence[int]) -> Generator[None]:
        """The machine measures these sweeps of a campaign: one, or those of one trajectory (then a list)."""
        with self._bound({CAMPAIGN: campaign, SWEEP: numbers[0] if len(numbers) == 1 else list(numbers)}):
            yield

    def add(self, logger: WrappedLogger, method: str, line: EventDict) -> EventDict:
        """A structlog processor, to come after `merge_contextvars`: completes a line of no other campaign."""
        fields = self._fields
        if line.get(CAMPAIGN, fields.get(CAMPAIGN)) == fields.get(CAMPAIGN):
            for name, value in fields.items():
                line.setdefault(name, value)
        return line

    @contextmanager
    def _bound(self, fields: dict[str, object]) -> Generator[None]:
        before, self._fields = self._fields, fields
        try:
            with bound_contextvars(**fields):
                yield
        finally:
            self._fields = before


MACHINE = MachineWork()


def current() -> dict[str, object]:
    """The fields for lines of this task, also for a process that works for it."""
    return get_contextvars()


async def in_executor(
    executor: Executor, work: Callable[Arguments, Result], *args: Arguments.args, **kwargs: Arguments.kwargs
) -> Result:
    """As `loop.run_in_executor`, which does not copy the context."""
    context = contextvars.copy_context()
    return await asyncio.get_running_loop().run_in_executor(
        executor, partial(context.run, partial(work, *args, **kwargs))
    )
