"""Identification and diagnosis in worker processes, on Dask: a busy Python thread would delay the set-points.

A job carries all it needs but the samples, which it reads from the recording files; it is a function of its
content alone, so that a killed worker's job gives the same result when Dask runs it again. Nothing is kept here:
the durable job is the row of the sweep or of the diagnosis.
"""

import asyncio
import os
import sys
from collections.abc import AsyncGenerator, Mapping
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar, cast

import distributed
from pydantic import JsonValue

from service.data_check import check, findings_document
from service.diagnosis import axis_document, diagnose_axis, started_from
from service.diagnosis.calibration import Weighed
from service.diagnosis.parameters import Parameter
from service.errors import SweepidError
from service.estimation import estimate_document, spectrum_from, sweep_spectrum
from service.identification.analysis_document import analyses_from
from service.identification.known_effects import known_effects
from service.identification.torque_gain import KnownMass
from service.recording import Sweep, SweepSpec
from service.robot import RobotDescription, build_robot
from service.store.columns import read_columns

# distributed ships without types
_dask = cast(Any, distributed)

_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
_CONNECT_TIMEOUT = 5.0  # s
_NICE = 10

_Answer = TypeVar("_Answer", covariant=True)


class JobFailed(SweepidError):
    """The job could not be done, and could not be another time: the message says why."""


class WorkerLost(SweepidError):
    """The scheduler does not answer, or forgot the job: it may be submitted again."""


class Work(Protocol[_Answer]):
    """A job of any kind."""

    @property
    def key(self) -> str:
        """The same work has the same key."""
        ...

    @property
    def priority(self) -> int:
        """What waits in the workers' queue gives way to more."""
        ...

    def __call__(self) -> _Answer:
        """Do it."""
        ...


@dataclass(frozen=True, slots=True)
class Job:
    """Identify one recorded sweep and, with the spectra of the sweeps before it, the robot."""

    key: str
    robot: RobotDescription
    urdf_text: str
    spec: SweepSpec
    path: Path
    earlier: tuple[dict[str, JsonValue], ...]  # spectrum documents
    analyses: dict[str, JsonValue]  # "analysis" of the campaign that the plan names, {} if it names none
    model: dict[str, JsonValue] | None = None  # "axes" of the robot's model, and its "source"; None: it has none yet

    @property
    def priority(self) -> int:
        return 1  # the campaign that is under way may end when enough is known

    def __call__(self) -> "Result":
        robot = build_robot(self.robot, self.urdf_text)
        new = sweep_spectrum(robot, Sweep(self.spec, read_columns(self.path)))
        earlier = [spectrum_from(document) for document in self.earlier]
        analyses = analyses_from(cast("dict[str, Any]", self.analyses))
        known = None
        if self.model is not None:
            model = cast("dict[str, Any]", self.model)
            known = known_effects(model, robot.joints, model["source"])
        return Result(new.to_document(), estimate_document(robot, [*earlier, new], analyses, known=known))


@dataclass(frozen=True, slots=True)
class Result:
    """`to_document()` of the sweep's spectrum and `estimate_document` with it."""

    spectrum: dict[str, JsonValue]
    estimate: dict[str, JsonValue]


@dataclass(frozen=True, slots=True)
class RecordedSweep:
    """A sweep whose samples lie in a file."""

    spec: SweepSpec
    path: Path

    def read(self) -> Sweep:
        return Sweep(self.spec, read_columns(self.path))


@dataclass(frozen=True, slots=True)
class DiagnosisJob:
    """Diagnose one axis; `known`: effects of the model with its parameters; `weighed`: sweeps with a known `mass`."""

    key: str
    robot: RobotDescription
    urdf_text: str
    joint: str
    sweeps: tuple[RecordedSweep, ...]
    known: Mapping[str, Mapping[str, Parameter]]
    mass: KnownMass | None
    weighed: tuple[RecordedSweep, ...]
    estimate: Mapping[str, JsonValue] | None = None  # document from which the rigid model starts; None: CAD
    started_from: str = ""  # which estimate that is

    @property
    def priority(self) -> int:
        return 0

    def __call__(self) -> dict[str, JsonValue]:
        robot = build_robot(self.robot, self.urdf_text)
        if self.estimate is not None:
            robot = started_from(robot, self.estimate, self.started_from)
        sweeps = [sweep.read() for sweep in self.sweeps]
        weighed = None
        if self.mass is not None:
            weighed = Weighed(self.mass, tuple(sweep.read() for sweep in self.weighed))
        return axis_document(diagnose_axis(robot, self.joint, sweeps, known=self.known, weighed=weighed))


@dataclass(frozen=True, slots=True)
class CheckJob:
    """Check the data of sweeps, before any physics."""

    key: str
    robot: RobotDescription
    urdf_text: str
    sweeps: tuple[RecordedSweep, ...]

    @property
    def priority(self) -> int:
        return 0

    def __call__(self) -> dict[str, JsonValue]:
        robot = build_robot(self.robot, self.urdf_text)
        sweeps = [sweep.read() for sweep in self.sweeps]
        return findings_document(robot, sweeps, check(robot, sweeps))


def work(job: Work[_Answer]) -> _Answer:
    """Do a job. Runs in the worker process, which gives way to the one that streams set-points."""
    if sys.platform != "win32":
        os.setpriority(os.PRIO_PROCESS, 0, _NICE)
    return job()


class Worker:
    """Where jobs are done: the workers of the Dask scheduler at an address."""

    def __init__(self, scheduler: str) -> None:
        self._scheduler = scheduler
        self._client: Any = None
        self._connecting = asyncio.Lock()

    async def run(self, job: Work[_Answer]) -> _Answer:
        """The result of a job; JobFailed or WorkerLost. A worker that dies is replaced and its job run again."""
        client = await self._connected()
        future = client.submit(work, job, key=job.key, priority=job.priority)
        error = cast(BaseException | None, await future.exception())  # waits; an error is returned, not raised
        if error is not None:
            raise JobFailed(f"{type(error).__name__}: {error}")
        if future.status != "finished":
            raise WorkerLost(f"job {job.key} was {future.status}: {self._scheduler} went away")
        return cast(_Answer, await future)

    async def processes(self) -> tuple[int, ...]:
        """Process ids of the workers; WorkerLost while the scheduler does not answer."""
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
            return await client
        except OSError as error:
            raise WorkerLost(f"Dask scheduler {self._scheduler}: {error}") from None
        finally:
            if client.status != "running":  # cancelled, too
                await client.close()


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
