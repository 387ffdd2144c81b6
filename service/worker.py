"""Identification in worker processes, on Dask: a busy Python thread would delay the machine's set-points.

A job carries all it needs but the samples, which it reads from the recording file; it is a function of its
content alone, so that a killed worker's job gives the same result when Dask runs it again. Nothing is kept here:
the durable job is the sweep's row.
"""

import os
import sys
from collections.abc import AsyncGenerator
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import distributed
from pydantic import JsonValue

from service.errors import SweepidError
from service.estimation import estimate_document, spectrum_from, sweep_spectrum
from service.identification.analysis_document import analyses_from
from service.recording import Sweep, SweepSpec
from service.robot import RobotDescription, build_robot
from service.store.columns import read_columns

# distributed ships without types
_dask = cast(Any, distributed)

_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
_CONNECT_TIMEOUT = 5.0  # s
_NICE = 10


class JobFailed(SweepidError):
    """The sweep could not be identified, and would not be another time: the message says why."""


class WorkerLost(SweepidError):
    """The scheduler does not answer, or forgot the job: it may be submitted again."""


@dataclass(frozen=True, slots=True)
class Job:
    """Identify one recorded sweep and, with the spectra of the sweeps before it, the robot."""

    key: str  # the same work has the same key
    robot: RobotDescription
    urdf_text: str
    spec: SweepSpec
    path: Path
    earlier: tuple[dict[str, JsonValue], ...]  # spectrum documents
    analyses: dict[str, JsonValue]  # "analysis" of the campaign that the plan names, {} if it names none


@dataclass(frozen=True, slots=True)
class Result:
    """`to_document()` of the sweep's spectrum and `estimate_document` with it."""

    spectrum: dict[str, JsonValue]
    estimate: dict[str, JsonValue]


def work(job: Job) -> Result:
    """Do a job. Runs in the worker process, which gives way to the one that streams set-points."""
    if sys.platform != "win32":
        os.setpriority(os.PRIO_PROCESS, 0, _NICE)
    robot = build_robot(job.robot, job.urdf_text)
    new = sweep_spectrum(robot, Sweep(job.spec, read_columns(job.path)))
    earlier = [spectrum_from(document) for document in job.earlier]
    analyses = analyses_from(cast("dict[str, Any]", job.analyses))
    return Result(new.to_document(), estimate_document(robot, [*earlier, new], analyses))


class Worker:
    """Where jobs are done: the workers of the Dask scheduler at an address."""

    def __init__(self, scheduler: str) -> None:
        self._scheduler = scheduler
        self._client: Any = None

    async def run(self, job: Job) -> Result:
        """The result of a job; JobFailed or WorkerLost. A worker that dies is replaced and its job run again."""
        client = await self._connected()
        future = client.submit(work, job, key=job.key)
        error = cast(BaseException | None, await future.exception())  # waits; an error is returned, not raised
        if error is not None:
            raise JobFailed(f"{type(error).__name__}: {error}")
        if future.status != "finished":
            raise WorkerLost(f"job {job.key} was {future.status}: {self._scheduler} went away")
        return cast(Result, await future)

    async def processes(self) -> tuple[int, ...]:
        """Process ids of the workers; WorkerLost while the scheduler does not answer."""
        client = await self._connected()
        return tuple(cast("dict[str, int]", await client.run(os.getpid)).values())

    async def close(self) -> None:
        if self._client is not None:
            await self._client.close()

    async def _connected(self) -> Any:
        if self._client is None or self._client.status == "closed":
            try:
                self._client = await _dask.Client(self._scheduler, asynchronous=True, timeout=_CONNECT_TIMEOUT)
            except OSError as error:
                raise WorkerLost(f"Dask scheduler {self._scheduler}: {error}") from None
        return self._client


@asynccontextmanager
async def open_worker(scheduler: str | None) -> AsyncGenerator[Worker]:
    """The workers of the Dask scheduler at an address, or (None) one worker process of our own."""
    async with AsyncExitStack() as stack:
        if scheduler is None:
            cluster = await stack.enter_async_context(
                _dask.LocalCluster(
                    asynchronous=True,
                    n_workers=1,
                    threads_per_worker=1,
                    processes=True,
                    host="127.0.0.1",
                    dashboard_address="127.0.0.1:0",  # Dask insists on an HTTP server: any free port, this machine only
                    env=_ONE_THREAD,
                )
            )
            scheduler = cast(str, cluster.scheduler_address)
        worker = Worker(scheduler)
        stack.push_async_callback(worker.close)
        yield worker
