"""The workers of an external Dask cluster. They read spectra under the same paths, and recordings too
unless these are in an object store.

The scheduler loses all jobs when it ends; the store is the outbox, and the caller submits the job again. Beyond this
computer the connection has mutual TLS (`service.process.settings`).
"""

import asyncio
import hashlib
import os
import pickle
from concurrent.futures import CancelledError as Cancelled
from contextlib import suppress
from typing import Any, cast

import dask.config
import distributed
from distributed.client import ClosedClientError
from distributed.comm.core import CommClosedError

from service import NotNow
from service.jobs.work import TRACEPARENT, Answer, JobFailed, Work, Worker, WorkerLost, work
from service.process.logs import current
from service.process.settings import Cluster
from service.process.telemetry import TRACING

# distributed has no type information
_dask = cast(Any, distributed)


# messages that the client remembers, each with its jobs; distributed's 1000 of them were 60 MiB
# read by every (re)connection of a client in this process; the scheduler and the workers read config/dask
dask.config.set({"distributed.admin.low-level-log-length": 10})


class DaskWorkers(Worker):
    """The workers of one scheduler."""

    def __init__(self, cluster: Cluster) -> None:
        self._cluster = cluster
        self._client: Any = None
        self._connecting = asyncio.Lock()

    async def run(self, job: Work[Answer]) -> Answer:
        client = await self._connected()
        try:
            key = await asyncio.to_thread(_key, job)
            future = client.submit(
                work, job, {**current(), TRACEPARENT: TRACING.traceparent}, key=key, priority=job.priority
            )
            error = await self._error(client, future)
            if isinstance(error, NotNow):
                raise error
            if error is not None:
                raise JobFailed(f"{type(error).__name__}: {error}")
            if future.status != "finished":
                raise self._lost(job, future.status)
            return cast(Answer, await future)
        except (Cancelled, CommClosedError, ClosedClientError) as error:  # possible at each of these lines
            raise self._lost(job, str(error)) from None

    async def processes(self) -> tuple[int, ...]:
        client = await self._connected()
        try:
            return tuple(cast("dict[str, int]", await client.run(os.getpid)).values())
        except OSError as error:
            raise WorkerLost(f"Dask scheduler {self._cluster.scheduler}: {error}") from None

    async def close(self) -> None:
        if self._client is not None:
            await self._client.close()

    async def _error(self, client: Any, future: Any) -> BaseException | None:
        """Waits for the end of the job. Returns its error, or None."""
        waiting = asyncio.ensure_future(future.exception())
        try:
            while not (await asyncio.wait([waiting], timeout=2.0))[0]:
                if client.status == "closed":
                    raise Cancelled("the connection was closed")
            return cast(BaseException | None, await waiting)
        finally:
            waiting.cancel()
            with suppress(asyncio.CancelledError):
                await asyncio.wait([waiting])

    def _lost(self, job: Work[object], why: str) -> WorkerLost:
        return WorkerLost(f"job {job.key}: connection to {self._cluster.scheduler} lost ({why})")

    async def _connected(self) -> Any:
        async with self._connecting:
            while self._client is not None and self._client.status == "connecting":  # tries for the time-out
                self.trouble = f"Dask scheduler {self._cluster.scheduler}: connection lost, trying again"
                await asyncio.sleep(0.1)
            if self._client is None or self._client.status in ("closing", "closed"):
                self._client = await self._connect()
            self.trouble = ""
            return self._client

    async def _connect(self) -> Any:
        address = self._cluster.scheduler
        client = _dask.Client(address, asynchronous=True, timeout=5.0, security=self._security())
        try:
            connected = await client
        except OSError as error:
            self.trouble = f"Dask scheduler {address}: {error}"
            raise WorkerLost(self.trouble) from None
        finally:
            if client.status != "running":  # also at cancellation
                await client.close()
        return connected

    def _security(self) -> Any:
        """Both sides need a certificate of the same authority."""
        files = self._cluster.certificates
        if files is None:
            return None
        return _dask.Security(
            tls_ca_file=str(files.authority),
            tls_client_cert=str(files.certificate),
            tls_client_key=str(files.key),
            require_encryption=True,
        )


def _key(job: Work[object]) -> str:
    """A key from the complete content: services with a common scheduler may have jobs with the same key and different
    content, and the scheduler would give one of them the result of the other."""
    return f"{job.key.partition('-')[0]}-{hashlib.sha256(pickle.dumps(job)).hexdigest()}"
