"""Jobs on a real Dask scheduler with real workers over mutual TLS, which are killed and started again."""

import asyncio
import os
import tracemalloc
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from service.jobs.work import JobFailed, Worker, WorkerLost
from service.jobs.worker import open_worker
from service.process.settings import Certificates, Cluster
from tests.programs import needs
from tests.unit.service.cluster import DaskProcesses, certificates

pytestmark = [pytest.mark.slow, needs("openssl")]
PATIENCE = 240.0  # s
SIZE = 100_000  # bytes of a large job


@dataclass(frozen=True)
class Squared:
    """The square of a number, once `gate` (a file) is there."""

    number: int
    gate: str = ""
    begun: str = ""
    key: str = "squared-1"
    priority: int = 0

    def __call__(self) -> int:
        if self.begun:
            Path(self.begun).write_text(str(os.getpid()), "utf-8")
        while self.gate and not Path(self.gate).exists():
            pass
        return self.number**2


@dataclass(frozen=True)
class Wrong:
    key: str = "wrong"
    priority: int = 0

    def __call__(self) -> None:
        raise ValueError("no such thing")


@dataclass(frozen=True)
class Length:
    """Of numbers, which go the way of a spectrum."""

    numbers: bytes
    key: str = "length-1"
    priority: int = 0

    def __call__(self) -> int:
        return len(self.numbers)


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
async def worker(dask: DaskProcesses) -> AsyncIterator[Worker]:
    async with open_worker(dask.cluster) as worker:
        yield worker


async def done(worker: Worker, job: Squared) -> int:
    return await asyncio.wait_for(worker.run_patiently(job), PATIENCE)


async def test_jobs_are_done_over_mutual_tls(worker: Worker) -> None:
    assert await done(worker, Squared(7)) == 49
    assert not worker.trouble
    with pytest.raises(JobFailed, match="ValueError: no such thing"):
        await worker.run(Wrong())


async def test_jobs_of_one_key_and_other_content_are_not_mixed_up(worker: Worker) -> None:
    found = await asyncio.gather(*(done(worker, Squared(number)) for number in range(20)))
    assert found == [number**2 for number in range(20)]


async def test_the_service_does_not_keep_the_jobs_that_were_done(worker: Worker) -> None:
    async def send(jobs: int) -> None:
        for _ in range(jobs):
            assert await asyncio.wait_for(worker.run(Length(os.urandom(SIZE))), PATIENCE) == SIZE

    await send(20)
    tracemalloc.start()
    try:
        await send(60)
        kept, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert kept < 20 * SIZE


async def test_a_stranger_is_refused(dask: DaskProcesses, worker: Worker, tmp_path: Path) -> None:
    assert await done(worker, Squared(2)) == 4
    others = certificates(tmp_path / "others", "stranger")
    mixed = Certificates(dask.files.authority, others.certificate, others.key)
    plain = Cluster(dask.cluster.scheduler.replace("tls", "tcp"))
    for stranger in (Cluster(dask.cluster.scheduler, others), Cluster(dask.cluster.scheduler, mixed), plain):
        async with open_worker(stranger) as refused:
            with pytest.raises(WorkerLost):
                await asyncio.wait_for(refused.run(Squared(3)), PATIENCE)
            assert dask.cluster.scheduler.partition("//")[2] in refused.trouble


async def test_the_death_of_a_worker_and_of_the_scheduler_loses_no_job(
    dask: DaskProcesses, worker: Worker, tmp_path: Path
) -> None:
    gate, begun = tmp_path / "gate", tmp_path / "begun"
    running = asyncio.create_task(done(worker, Squared(11, str(gate), str(begun))))
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
    assert await running == 121


async def _there(path: Path) -> None:
    while not await asyncio.to_thread(path.exists):  # noqa: ASYNC110
        await asyncio.sleep(0.05)
