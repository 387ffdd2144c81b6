"""An archive: campaigns of virtual robots in a real store, recorded and identified as a service does it."""

import asyncio
from collections.abc import AsyncGenerator, Iterator, Sequence
from contextlib import asynccontextmanager, contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from service.jobs.jobs import Batches, Jobs
from service.jobs.worker import Worker
from service.model import Sweep
from service.store.database import Database, open_database
from service.store.diagnoses import ModelStore
from service.store.documents import BatchState, CampaignState
from service.store.files.bundle import Bundle, save_bundle
from service.store.files.data_folder import import_campaign
from service.store.files.recordings import RecordingFiles
from service.store.plant import BatchStore
from service.store.store import Store
from tests.numeric.campaign import max100, measure_at, scenario_named


@dataclass(frozen=True)
class Archive:
    """`campaigns`: their numbers, in the order in which they were stored."""

    database: Database
    store: Store
    files: RecordingFiles
    batches: BatchStore
    campaigns: tuple[int, ...]

    async def identify(self, worker: Worker) -> None:
        """As after an import: one job a sweep."""
        jobs = Jobs(self.store, self.files, worker, ModelStore(self.database))
        try:
            await jobs.recover()
            while any(self.store.campaign(one).state is not CampaignState.COMPLETED for one in self.campaigns):  # noqa: ASYNC110
                await asyncio.sleep(0.05)
        finally:
            await jobs.close()

    @asynccontextmanager
    async def service(self, worker: Worker) -> AsyncGenerator[Batches]:
        """What computes batches, as long as the block runs; what is open stays open then."""
        found = Batches(self.store, self.batches, ModelStore(self.database), self.files, worker)
        try:
            yield found
        finally:
            await found.close()

    async def again(self, worker: Worker, campaigns: Sequence[int] | None = None) -> int:
        """Identify them again, to the end; the number of the batch."""
        async with self.service(worker) as batches:
            number = (await batches.request(campaigns, "a test")).id
            await self.over(number)
            return number

    async def over(self, number: int) -> None:
        while self.batches.batch(number).state not in (BatchState.DONE, BatchState.CANCELLED):  # noqa: ASYNC110
            await asyncio.sleep(0.05)


@contextmanager
def archive(folder: Path, campaigns: int, poses: int, copies: int = 1) -> Iterator[Archive]:
    """Each campaign has `poses` sweeps of joint_2 and joint_3; each is stored `copies` times."""
    files = RecordingFiles(folder / "data")
    (folder / "data").mkdir()
    with open_database(f"sqlite:///{folder / 'plant.sqlite'}") as database:
        store = Store(database)
        numbers: list[int] = []
        for seed in range(campaigns):
            bundle = Bundle(max100(), sweeps_of(seed, poses))
            numbers += [import_campaign(store, files, save_bundle(files, bundle)).id for _ in range(copies)]
        yield Archive(database, store, files, BatchStore(database), tuple(numbers))


def sweeps_of(seed: int, poses: int) -> tuple[Sweep, ...]:
    grid = np.zeros((poses, 6))
    grid[:, 1:3] = np.random.default_rng(seed).uniform(-1.2, 1.2, (poses, 2))
    return measure_at(scenario_named("max100-full"), seed, grid, 250.0, axes=("joint_2", "joint_3")).sweeps
