"""Where jobs are done, whatever is behind it."""

import asyncio
import os
import sys
from abc import ABC, abstractmethod

import structlog

from service.errors import SweepidError
from service.worker.jobs import Answer, Work

_log = structlog.get_logger(__name__)

_AGAIN = 2.0  # s between attempts to reach the workers
_NICE = 10


class JobFailed(SweepidError):
    """The job could not be done, and could not be another time: the message says why."""


class WorkerLost(SweepidError):
    """Nobody answers who could do the job, or it was forgotten: it may be submitted again."""


class Worker(ABC):
    """One process of our own, or the workers of a cluster."""

    trouble: str = ""
    """Why no job can be done now; empty while none is known."""

    @abstractmethod
    async def run(self, job: Work[Answer]) -> Answer:
        """The result of a job; JobFailed or WorkerLost. A worker that dies is replaced and its job done again."""

    @abstractmethod
    async def processes(self) -> tuple[int, ...]:
        """Process ids of the workers; WorkerLost while nobody answers."""

    @abstractmethod
    async def close(self) -> None:
        """Give up what is under way."""

    async def run_patiently(self, job: Work[Answer]) -> Answer:
        """As `run`, again and again until somebody answers; JobFailed."""
        while True:
            try:
                return await self.run(job)
            except WorkerLost as error:
                _log.warning("worker_lost", reason=str(error))
                await asyncio.sleep(_AGAIN)


def give_way(process: int = 0) -> None:
    """A worker (by process id, 0: this one) gives way to the process that streams set-points."""
    if sys.platform != "win32":
        os.setpriority(os.PRIO_PROCESS, process, _NICE)


def work(job: Work[Answer]) -> Answer:
    """Do a job. Runs in the worker process."""
    give_way()
    return job()
