"""Interface of the workers that execute jobs."""

import asyncio
from abc import ABC, abstractmethod
from collections.abc import Mapping
from types import MappingProxyType

import structlog
from structlog.contextvars import bound_contextvars

from service.jobs.worker.jobs import Answer, Work
from service.model.errors import SweepidError
from service.process.tasks.child import give_way
from service.process.telemetry.spans import TRACING

_log = structlog.get_logger(__name__)

_AGAIN = 2.0  # s between attempts to reach the workers
TRACEPARENT = "traceparent"


class JobFailed(SweepidError):
    """The job failed, and would fail again: the message gives the reason."""


class WorkerLost(SweepidError):
    """No worker can do the job now, or the job was lost: it can be submitted again."""


class Worker(ABC):
    """One local process, or the workers of a cluster."""

    trouble: str = ""
    """Why no job can be done now; empty if no reason is known."""

    @abstractmethod
    async def run(self, job: Work[Answer]) -> Answer:
        """The result of a job. JobFailed, WorkerLost, or the job's own NotNow.

        A worker that has died is replaced, and its job is repeated.
        """

    @abstractmethod
    async def processes(self) -> tuple[int, ...]:
        """Process ids of the workers; WorkerLost while no worker answers."""

    @abstractmethod
    async def close(self) -> None:
        """Cancel all jobs."""

    async def run_patiently(self, job: Work[Answer]) -> Answer:
        """As `run`, repeated until a worker answers; JobFailed or NotNow."""
        while True:
            try:
                return await self.run(job)
            except WorkerLost as error:
                _log.warning("worker_lost", reason=str(error))
                await asyncio.sleep(_AGAIN)


def work(job: Work[Answer], about: Mapping[str, object] = MappingProxyType({})) -> Answer:
    """Do a job. Runs in the worker process. `about`: fields of its log lines, as in the log of the caller, and the
    span to which it belongs.
    """
    give_way()
    lines = {name: value for name, value in about.items() if name != TRACEPARENT}
    parent = str(about.get(TRACEPARENT, ""))
    with bound_contextvars(job=job.key, **lines), TRACING.span(type(job).__name__, parent, job=job.key):
        return job()
