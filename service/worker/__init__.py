"""Identification and diagnosis in another process: a busy Python thread would delay the set-points."""

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager

from service.worker.jobs import CheckJob, DiagnosisJob, Job, RecordedSweep, Result, Work
from service.worker.process import WorkerProcess
from service.worker.report_job import DiagnosisReportJob, ReportJob, Written
from service.worker.worker import JobFailed, Worker, WorkerLost, work

__all__ = [
    "CheckJob",
    "DiagnosisJob",
    "DiagnosisReportJob",
    "Job",
    "JobFailed",
    "RecordedSweep",
    "ReportJob",
    "Result",
    "Work",
    "Worker",
    "WorkerLost",
    "Written",
    "open_worker",
    "work",
]


@asynccontextmanager
async def open_worker(scheduler: str | None) -> AsyncGenerator[Worker]:
    """The workers of the Dask scheduler at an address, or (None) one worker process of our own."""
    if scheduler is None:
        worker: Worker = WorkerProcess()
    else:
        # only who has a cluster pays for what Dask imports
        from service.worker.dask_workers import DaskWorkers

        worker = DaskWorkers(scheduler)
    try:
        yield worker
    finally:
        await worker.close()
