"""The log: one JSON object per line on stderr, for lines of the service and of its libraries.

A task, and each thread it starts, has its campaign and sweep in its context (`structlog.contextvars`). A line from
another source, such as the thread that receives frames, gets the present campaign and sweep of the machine.
"""

import asyncio
import contextvars
import logging
import sys
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from functools import partial
from typing import ParamSpec, TypeVar

import structlog
from structlog.contextvars import bound_contextvars, get_contextvars
from structlog.typing import EventDict, WrappedLogger

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


class MachineWork:
    """The present work of the machine. One instance per process: a process has one machine, and one log."""

    def __init__(self) -> None:
        self._fields: Mapping[str, object] = {}  # replaced as a whole, because other threads read it

    @contextmanager
    def campaign(self, number: int) -> Generator[None]:
        """The machine works for this campaign."""
        with self._bound({"campaign": number}):
            yield

    @contextmanager
    def sweeps(self, campaign: int, numbers: Sequence[int]) -> Generator[None]:
        """The machine measures these sweeps of a campaign: one, or those of one trajectory (then a list)."""
        with self._bound({"campaign": campaign, "sweep": numbers[0] if len(numbers) == 1 else list(numbers)}):
            yield

    def add(self, logger: WrappedLogger, method: str, line: EventDict) -> EventDict:
        """A structlog processor, to come after `merge_contextvars`: completes a line of no other campaign."""
        fields = self._fields
        if line.get("campaign", fields.get("campaign")) == fields.get("campaign"):
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


def configure_logs(level: str | int) -> None:
    """Call once, in the process that writes the log. Warnings of Python are logged, too."""
    shared: list[structlog.typing.Processor] = [
        structlog.contextvars.merge_contextvars,
        MACHINE.add,
        structlog.stdlib.add_log_level,
        structlog.stdlib.add_logger_name,
        structlog.processors.TimeStamper(fmt="iso", utc=True),
        structlog.stdlib.ExtraAdder(),
        structlog.processors.format_exc_info,
    ]
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(
        structlog.stdlib.ProcessorFormatter(
            foreign_pre_chain=shared,
            processors=[
                structlog.stdlib.ProcessorFormatter.remove_processors_meta,
                structlog.processors.JSONRenderer(),
            ],
        )
    )
    logging.basicConfig(handlers=[handler], level=level, force=True)
    logging.captureWarnings(True)
    for name in ("can", "canopen"):  # they log every frame and transfer; the drive adapter reports their errors itself
        logging.getLogger(name).setLevel(logging.ERROR)
    structlog.configure(
        processors=[*shared, structlog.stdlib.ProcessorFormatter.wrap_for_formatter],
        logger_factory=structlog.stdlib.LoggerFactory(),
        wrapper_class=structlog.stdlib.BoundLogger,
    )
