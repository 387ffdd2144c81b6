"""Jobs in a real worker process, which is killed in the middle of one."""

import asyncio
import os
import signal
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from service.campaigns.envelope import Envelope
from service.cell import Cell
from service.configuration import read_robot
from service.robot import Robot
from service.worker import Job, JobFailed, Worker, WorkerLost, open_worker, work
from tests.unit.service.campaigns.conftest import ROOT, open_bench, until


@pytest.fixture(scope="module")
def robot() -> Robot:
    return read_robot(ROOT / "config" / "robots" / "max100-class.yaml")


@pytest.fixture
async def job(tmp_path: Path, robot: Robot) -> Job:
    """The second sweep of a formula campaign, with the spectrum of the first."""
    async with open_bench(tmp_path, robot, Envelope(robot, Cell(name="empty"))) as bench:
        await bench.runner.start(bench.campaign.id)
        await bench.runner.finished()
        jobs = [
            Job(f"job-{n}", robot.description, robot.urdf_text, bench.store.sweep(1, n).spec, path, (), {})
            for n in (1, 2)
            for path in [bench.files.path(bench.store.recording(1, n))]
        ]
    return Job("job", robot.description, robot.urdf_text, jobs[1].spec, jobs[1].path, (work(jobs[0]).spectrum,), {})


@pytest.fixture
async def worker() -> AsyncIterator[Worker]:
    async with open_worker(None) as worker:
        yield worker


async def test_a_worker_killed_in_mid_job_changes_nothing(job: Job, worker: Worker) -> None:
    expected = work(job)
    real = job.path.with_suffix(".real")
    job.path.rename(real)
    os.mkfifo(job.path)  # whoever reads it waits: the job is in its middle for as long as we like
    (before,) = await worker.processes()
    running = asyncio.create_task(worker.run(job))
    held: list[int] = []
    await until(lambda: _open_for_writing(job.path, held))
    os.kill(before, signal.SIGKILL)
    os.close(held[0])
    real.replace(job.path)
    result = await asyncio.wait_for(running, 60)
    (after,) = await worker.processes()
    assert after != before
    assert result == expected


async def test_the_worker_gives_what_the_mathematics_gives(job: Job, worker: Worker) -> None:
    assert await worker.run(job) == work(job)


async def test_a_job_that_cannot_be_done_says_why(job: Job, worker: Worker) -> None:
    job.path.write_bytes(b"not parquet")
    with pytest.raises(JobFailed, match=r"BadInput: .*cannot be read"):
        await worker.run(job)


async def test_a_scheduler_that_does_not_answer_is_told(job: Job) -> None:
    async with open_worker("tcp://127.0.0.1:9") as worker:
        with pytest.raises(WorkerLost, match=r"tcp://127\.0\.0\.1:9"):
            await worker.run(job)


def _open_for_writing(pipe: Path, held: list[int]) -> bool:
    """Open a pipe once somebody reads it; while it is held open, the reader waits for more."""
    try:
        held.append(os.open(pipe, os.O_WRONLY | os.O_NONBLOCK))
    except OSError:  # ENXIO: nobody has it open for reading
        return False
    return True
