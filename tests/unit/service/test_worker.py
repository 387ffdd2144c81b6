"""Jobs in a real worker process, and on a real Dask scheduler over mutual TLS: both are killed and lose no job."""

import asyncio
import os
import signal
import subprocess
import sys
import tracemalloc
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil
import pytest

from service.jobs.work import Job, JobFailed, RecordedSweep, Worker, WorkerLost, work
from service.jobs.worker import open_worker
from service.model import Robot
from service.model.configuration import Cell, read_robot
from service.planning.safety.envelope_check import Envelope
from service.process.settings import Certificates, Cluster
from service.store.files.recordings import SpectrumFile
from tests.programs import needs
from tests.unit.service.campaigns.conftest import ROOT, open_bench, until
from tests.unit.service.cluster import DaskProcesses, certificates

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def robot() -> Robot:
    return read_robot(ROOT / "config" / "robots" / "max100-class.yaml")


@pytest.fixture
async def job(tmp_path: Path, robot: Robot) -> Job:
    """The second sweep of a formula campaign, with the spectrum of the first."""

    def of_one(sweep: RecordedSweep, number: int, earlier: tuple[SpectrumFile, ...] = ()) -> Job:
        return Job(f"job-{number}", robot.description, robot.urdf_text, (sweep,), earlier, {}, {})

    async with open_bench(tmp_path, robot, Envelope(robot, Cell(name="empty"))) as bench:
        await bench.start()
        await bench.over()
        recordings = [bench.store.recording(1, number) for number in (1, 2)]
        first, second = (
            RecordedSweep(bench.store.sweep(1, recording.number).spec, bench.files.named(recording))
            for recording in recordings
        )
    (spectrum,) = work(of_one(first, 1)).spectra
    earlier = bench.files.spectrum(bench.files.save_spectrum(recordings[0].path, spectrum))
    return of_one(second, 2, (earlier,))


@pytest.fixture
async def worker() -> AsyncIterator[Worker]:
    async with open_worker(None) as worker:
        yield worker


async def test_a_worker_killed_in_mid_job_changes_nothing(job: Job, worker: Worker) -> None:
    expected = work(job)
    real = job.sweeps[0].file.path.with_suffix(".real")
    job.sweeps[0].file.path.rename(real)
    os.mkfifo(job.sweeps[0].file.path)  # whoever reads it waits: the job is in its middle for as long as we like
    (before,) = await worker.processes()
    running = asyncio.create_task(worker.run(job))
    held: list[int] = []
    await until(lambda: _open_for_writing(job.sweeps[0].file.path, held))
    os.kill(before, signal.SIGKILL)
    os.close(held[0])
    real.replace(job.sweeps[0].file.path)
    result = await asyncio.wait_for(running, 60)
    (after,) = await worker.processes()
    assert after != before
    assert result == expected


async def test_a_job_that_cannot_be_done_says_why(job: Job, worker: Worker) -> None:
    (earlier,) = job.earlier
    earlier.path.write_bytes(earlier.path.read_bytes()[:-1])
    with pytest.raises(JobFailed, match=r"BadInput: .*spectrum file was changed"):
        await worker.run(job)
    job.sweeps[0].file.path.write_bytes(b"not parquet")
    with pytest.raises(JobFailed, match=r"BadInput: .*cannot be read"):
        await worker.run(job)


async def test_a_worker_killed_after_a_job_is_replaced_before_the_next(job: Job, worker: Worker) -> None:
    expected = work(job)
    assert await worker.run(job) == expected
    (before,) = await worker.processes()
    os.kill(before, signal.SIGKILL)
    await until(lambda: bool(worker.trouble))
    assert "is restarted" in worker.trouble
    await until(lambda: not worker.trouble)
    assert await worker.processes() != (before,)
    for _ in range(2):  # at once: nobody has noticed yet
        os.kill((await worker.processes())[0], signal.SIGKILL)
        assert await asyncio.wait_for(worker.run(job), 60) == expected


@dataclass(frozen=True)
class Call:
    """A job that calls a function."""

    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    key: str = "call-1"
    priority: int = 0

    def __call__(self) -> Any:
        return self.function(*self.arguments)


async def test_a_job_that_ends_every_process_ends_itself_and_no_other(job: Job, worker: Worker) -> None:
    with pytest.raises(JobFailed, match="while it executed this job"):
        await asyncio.wait_for(worker.run(Call(os._exit, (1,))), 120)
    assert await worker.run(job) == work(job)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no niceness")
async def test_it_gives_way_before_it_has_a_job_and_what_is_urgent_comes_first(worker: Worker) -> None:
    (process,) = await worker.processes()
    assert os.getpriority(os.PRIO_PROCESS, process) == 10
    done: list[str] = []
    jobs = [Call(str, (name,), priority=name == "urgent") for name in ("first", "late", "urgent")]
    running = [asyncio.create_task(worker.run(each)) for each in jobs]
    for each in running:
        each.add_done_callback(lambda task: done.append(task.result()))
    await asyncio.wait(running)
    assert done.index("urgent") < done.index("late")


def test_a_worker_ends_with_the_service(tmp_path: Path) -> None:
    """Which was killed, so that nobody is left to end it."""
    code = """
import asyncio, os, sys
from service.jobs.worker import open_worker
async def main():
    async with open_worker(None) as worker:
        print((await worker.processes())[0], flush=True)
        await asyncio.sleep(600)
if __name__ == "__main__":
    asyncio.run(main())
"""
    script = tmp_path / "owner.py"
    script.write_text(code, "utf-8")
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True) as owner:
        process = psutil.Process(int(owner.stdout.readline()) if owner.stdout else 0)
        owner.kill()
    assert psutil.wait_procs([process], timeout=60)[1] == []


async def test_a_scheduler_that_does_not_answer_is_told(job: Job) -> None:
    async with open_worker(Cluster("tcp://127.0.0.1:9")) as worker:
        with pytest.raises(WorkerLost, match=r"tcp://127\.0\.0\.1:9"):
            await worker.run(job)


def _open_for_writing(pipe: Path, held: list[int]) -> bool:
    """Open a pipe once somebody reads it; while it is held open, the reader waits for more."""
    try:
        held.append(os.open(pipe, os.O_WRONLY | os.O_NONBLOCK))
    except OSError:  # ENXIO: nobody has it open for reading
        return False
    return True


PATIENCE = 240.0  # s


SIZE = 100_000  # bytes of a large job


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Certificates:
    return certificates(tmp_path_factory.mktemp("authority"), "plant")


@pytest.fixture(scope="module")
def dask(tmp_path_factory: pytest.TempPathFactory, files: Certificates) -> Iterator[DaskProcesses]:
    processes = DaskProcesses.at_free_port(tmp_path_factory.mktemp("dask"), files)
    processes.start_scheduler()
    processes.start_worker()
    yield processes
    processes.close()


@pytest.fixture
async def dask_worker(dask: DaskProcesses) -> AsyncIterator[Worker]:
    async with open_worker(dask.cluster) as dask_worker:
        yield dask_worker


async def done(dask_worker: Worker, job: Call) -> Any:
    return await asyncio.wait_for(dask_worker.run_patiently(job), PATIENCE)


def held(gate: Path, begun: Path) -> str:
    """Begun, and over once the gate is there."""
    begun.write_text(str(os.getpid()), "utf-8")
    while not gate.exists():
        pass
    return "over"


@needs("openssl")
async def test_jobs_of_one_key_are_done_over_mutual_tls_and_not_mixed_up(dask_worker: Worker) -> None:
    found = await asyncio.gather(*(done(dask_worker, Call(pow, (number, 2))) for number in range(20)))
    assert found == [number**2 for number in range(20)]
    assert not dask_worker.trouble
    with pytest.raises(JobFailed, match=r"ValueError: .*'no such thing'"):
        await dask_worker.run(Call(int, ("no such thing",)))


@needs("openssl")
async def test_the_service_does_not_keep_the_jobs_that_were_done(dask_worker: Worker) -> None:
    async def send(jobs: int) -> None:
        for _ in range(jobs):
            assert await done(dask_worker, Call(len, (os.urandom(SIZE),))) == SIZE

    await send(20)
    tracemalloc.start()
    try:
        await send(60)
        kept, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert kept < 20 * SIZE


@needs("openssl")
async def test_a_stranger_is_refused(dask: DaskProcesses, dask_worker: Worker, tmp_path: Path) -> None:
    job = Call(abs, (-4,))
    assert await done(dask_worker, job) == 4
    others = certificates(tmp_path / "others", "stranger")
    mixed = Certificates(dask.files.authority, others.certificate, others.key)
    plain = Cluster(dask.cluster.scheduler.replace("tls", "tcp"))
    for stranger in (Cluster(dask.cluster.scheduler, others), Cluster(dask.cluster.scheduler, mixed), plain):
        async with open_worker(stranger) as refused:
            with pytest.raises(WorkerLost):
                await asyncio.wait_for(refused.run(job), PATIENCE)
            assert dask.cluster.scheduler.partition("//")[2] in refused.trouble


@needs("openssl")
async def test_the_death_of_a_worker_and_of_the_scheduler_loses_no_job(
    dask: DaskProcesses, dask_worker: Worker, tmp_path: Path
) -> None:
    gate, begun = tmp_path / "gate", tmp_path / "begun"
    running = asyncio.create_task(done(dask_worker, Call(held, (gate, begun))))
    await asyncio.wait_for(_there(begun), PATIENCE)
    dask.workers[0].kill()
    begun.unlink()
    dask.start_worker()
    await asyncio.wait_for(_there(begun), PATIENCE)  # begun again by another one
    assert dask.scheduler is not None
    dask.scheduler.kill()
    dask.scheduler.wait(60)
    dask.workers[1].kill()
    begun.unlink()
    dask.start_scheduler()
    dask.start_worker()
    await asyncio.wait_for(_there(begun), PATIENCE)  # submitted again to a scheduler that knew nothing
    gate.touch()
    assert await running == "over"


async def _there(path: Path) -> None:
    while not await asyncio.to_thread(path.exists):  # noqa: ASYNC110
        await asyncio.sleep(0.05)
