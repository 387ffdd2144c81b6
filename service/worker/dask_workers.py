"""The workers of a Dask cluster that somebody else runs. They read recordings and spectra under the same paths."""

import asyncio
import os
from typing import Any, cast

import distributed

from service.worker.jobs import Answer, Work
from service.worker.worker import JobFailed, Worker, WorkerLost, work

# distributed ships without types
_dask = cast(Any, distributed)

_CONNECT_TIMEOUT = 5.0  # s


class DaskWorkers(Worker):
    """The workers of the scheduler at an address."""

    def __init__(self, scheduler: str) -> None:
        self._scheduler = scheduler
        self._client: Any = None
        self._connecting = asyncio.Lock()

    async def run(self, job: Work[Answer]) -> Answer:
        client = await self._connected()
        future = client.submit(work, job, key=job.key, priority=job.priority)
        error = cast(BaseException | None, await future.exception())  # waits; an error is returned, not raised
        if error is not None:
            raise JobFailed(f"{type(error).__name__}: {error}")
        if future.status != "finished":
            raise WorkerLost(f"job {job.key} was {future.status}: {self._scheduler} went away")
        return cast(Answer, await future)

    async def processes(self) -> tuple[int, ...]:
        client = await self._connected()
        return tuple(cast("dict[str, int]", await client.run(os.getpid)).values())

    async def close(self) -> None:
        if self._client is not None:
            await self._client.close()

    async def _connected(self) -> Any:
        async with self._connecting:
            if self._client is None or self._client.status == "closed":
                self._client = await self._connect()
            return self._client

    async def _connect(self) -> Any:
        client = _dask.Client(self._scheduler, asynchronous=True, timeout=_CONNECT_TIMEOUT)
        try:
            connected = await client
        except OSError as error:
            self.trouble = f"Dask scheduler {self._scheduler}: {error}"
            raise WorkerLost(self.trouble) from None
        finally:
            if client.status != "running":  # cancelled, too
                await client.close()
        self.trouble = ""
        return connected
