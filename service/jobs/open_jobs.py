"""Jobs that the store keeps open, one task each: begun, begun again where the store or the disk refuses, and ended.

What a task does must bear to be begun again, as after a restart: the store is the outbox.
"""

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import nullcontext

import structlog
from sqlalchemy.exc import OperationalError

from service.store.database import refusal

_log = structlog.get_logger(__name__)

_AGAIN = 2.0  # s


class OpenJobs:
    """Those of one kind."""

    def __init__(self) -> None:
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._troubles: dict[str, str] = {}

    def __len__(self) -> int:
        return len(self._tasks)

    @property
    def troubles(self) -> tuple[str, ...]:
        """Why a job waits though a worker is there, or broke off until a restart; one line a job."""
        return tuple(f"{name}: {why}" for name, why in self._troubles.items())

    def begin(self, name: str, do: Callable[[], Awaitable[None]], turn: asyncio.Lock | None = None) -> None:
        """Do it, in a task of its own; no effect while one of that name is under way.

        All that share a `turn` are done one after the other, in the order of this call.
        """
        if name not in self._tasks:
            self._troubles.pop(name, None)
            task = asyncio.create_task(self._keep(name, do, turn), name=name)
            self._tasks[name] = task
            task.add_done_callback(self._done)

    async def close(self) -> None:
        """Leave what is open to the next process."""
        tasks = list(self._tasks.values())
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _keep(self, name: str, do: Callable[[], Awaitable[None]], turn: asyncio.Lock | None) -> None:
        async with turn or nullcontext():
            await self._patiently(name, do)

    async def _patiently(self, name: str, do: Callable[[], Awaitable[None]]) -> None:
        while True:
            try:
                await do()
            except (OperationalError, OSError) as error:  # locked, full, read-only: none of it stays so
                reason = refusal(error) if isinstance(error, OperationalError) else str(error).partition("\n")[0]
                _log.warning("job_waits", job=name, reason=reason)
                self._troubles[name] = reason
                await asyncio.sleep(_AGAIN)
            else:
                self._troubles.pop(name, None)
                return

    def _done(self, task: asyncio.Task[None]) -> None:
        name = task.get_name()
        del self._tasks[name]
        if not task.cancelled() and (error := task.exception()) is not None:
            # nothing was written: the next start begins it again
            self._troubles[name] = f"broke off until the service is restarted: {error!r}"
            _log.error("job_broke_off", job=name, exc_info=error)
