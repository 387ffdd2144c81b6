"""Open jobs of the store, one task each: started, repeated if the store or the disk fails, and ended.

A task must be repeatable, as after a restart: the store is the outbox.
"""

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from contextlib import nullcontext
from functools import partial

import structlog
from sqlalchemy.exc import OperationalError
from structlog.contextvars import bound_contextvars

from service.model.errors import NotNow
from service.store.database import refusal

_log = structlog.get_logger(__name__)

_AGAIN = 2.0  # s


class OpenJobs:
    """The open jobs of one kind; each kind derives from it."""

    def __init__(self) -> None:
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._sizes: dict[str, int] = {}
        self._troubles: dict[str, str] = {}

    @property
    def open(self) -> int:
        """How many items wait or run: the sum of the sizes of the open jobs."""
        return sum(self._sizes.values())

    @property
    def troubles(self) -> tuple[str, ...]:
        """Why a job waits although a worker is available, or was aborted until a restart; one line per job."""
        return tuple(f"{name}: {why}" for name, why in self._troubles.items())

    def begin(
        self,
        name: str,
        do: Callable[[], Awaitable[None]],
        turn: asyncio.Lock | None = None,
        size: int = 1,
        **about: int,
    ) -> None:
        """Run `do` in a task of its own; no effect if a task with this name is open.

        Tasks with the same `turn` run one after the other, in the order of the calls. `size`: number of its items.
        `about`: fields of its log lines, such as its campaign.
        """
        if name not in self._tasks:
            self._troubles.pop(name, None)
            self._sizes[name] = size
            task = asyncio.create_task(self._keep(name, do, turn, about), name=name)
            self._tasks[name] = task
            task.add_done_callback(partial(self._done, about))

    def end(self, name: str) -> None:
        """Cancel the task with this name, if it is open; data that it has stored are kept."""
        task = self._tasks.get(name)
        if task is not None:
            task.cancel()

    async def close(self) -> None:
        """Cancel all tasks; the next process continues the open jobs."""
        tasks = list(self._tasks.values())
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _keep(
        self, name: str, do: Callable[[], Awaitable[None]], turn: asyncio.Lock | None, about: Mapping[str, int]
    ) -> None:
        with bound_contextvars(**about):
            async with turn or nullcontext():
                await self._patiently(name, do)

    async def _patiently(self, name: str, do: Callable[[], Awaitable[None]]) -> None:
        while True:
            try:
                await do()
            except (OperationalError, OSError, NotNow) as error:  # locked, full, read-only, unreachable: temporary
                reason = refusal(error) if isinstance(error, OperationalError) else str(error).partition("\n")[0]
                _log.warning("job_waits", job=name, reason=reason)
                self._troubles[name] = reason
                await asyncio.sleep(_AGAIN)
            else:
                self._troubles.pop(name, None)
                return

    def _done(self, about: Mapping[str, int], task: asyncio.Task[None]) -> None:
        name = task.get_name()
        del self._tasks[name], self._sizes[name]
        if not task.cancelled() and (error := task.exception()) is not None:
            # nothing was written: the next start repeats it
            self._troubles[name] = f"failed; it is repeated at the next start of the service: {error!r}"
            _log.error("job_broke_off", job=name, exc_info=error, **about)
