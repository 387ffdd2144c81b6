"""Identification and diagnosis in a separate process: a busy Python thread would delay the set-points."""

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager

from service.jobs.worker.jobs import (
    CheckJob,
    DiagnosisJob,
    Job,
    RecordedSweep,
    Reidentified,
    ReidentifyJob,
    Result,
    Work,
)
from service.jobs.worker.process import WorkerProcess
from service.jobs.worker.report_job import DiagnosisReportJob, FleetReportJob, ReportJob, Written
from service.jobs.worker.worker import JobFailed, Worker, WorkerLost, work
from service.process.settings.telemetry import Telemetry
from service.process.settings.workers import Cluster

__all__ = [
    "CheckJob",
    "DiagnosisJob",
    "DiagnosisReportJob",
    "FleetReportJob",
    "Job",
    "JobFailed",
    "RecordedSweep",
    "Reidentified",
    "ReidentifyJob",
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
async def open_worker(
    cluster: Cluster | None, telemetry: Telemetry | None = None, machine: str = ""
) -> AsyncGenerator[Worker]:
    """The workers of a Dask cluster, or (None) one local worker process; its jobs are spans of `telemetry`."""
    if cluster is None:
        worker: Worker = WorkerProcess(telemetry, machine)
    else:
        # Dask is imported only if a cluster is used
        from service.jobs.worker.dask_workers import DaskWorkers

        worker = DaskWorkers(cluster)
    try:
        yield worker
    finally:
        await worker.close()
