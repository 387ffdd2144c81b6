"""A store with measured campaigns, and the diagnosis loop on it."""

import asyncio
from collections.abc import AsyncGenerator
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from service import SweepidError
from service.diagnosis.sensitivity import expected
from service.identification.design.diagnosis_sweeps import full_design
from service.identification.estimates.torque_gain import KnownMass
from service.identification.model import gravity_terms, inertia_rows
from service.jobs.dask_workers import DaskWorkers
from service.jobs.diagnosing import Diagnosing
from service.jobs.work import JobFailed, Work, Worker
from service.model import Robot, Sweep
from service.planning.diagnosis import ExperimentPlace
from service.process.settings import Cluster
from service.store.database import open_database
from service.store.diagnoses import DiagnosisStore, ModelStore
from service.store.documents import DiagnosisDocument, DiagnosisState, ModelDocument
from service.store.files.bundle import Bundle, save_bundle
from service.store.files.data_folder import import_campaign
from service.store.files.recordings import RecordingFiles
from service.store.store import Store
from tests.unit.service.campaigns.conftest import until

POSES = np.array([[0.0, -0.6, 0.4, 0.0, 0.0, 0.0], [0.5, 0.4, -0.7, 0.0, 0.0, 0.0]])
PATIENCE = 300.0  # s; the worker gives way to whatever else the computer does
NOBODY = Cluster("tcp://127.0.0.1:1")  # a scheduler that does not answer

Answer = TypeVar("Answer")


def measured(
    store: Store,
    files: RecordingFiles,
    robot: Robot,
    joint: str,
    seed: int,
    mass: KnownMass | None = None,
    coulomb: float = 60.0,
) -> int:
    """A campaign of slow sweeps of one axis with dry friction, and with a mass on the last link; its number."""
    random, index = np.random.default_rng(seed), robot.index(joint)
    body = np.zeros(robot.chain.inertial.size)
    if mass is not None:
        body[-10:] = mass.parameters
    motor = robot.axes[index].reflected_motor_inertia or 0.0
    sweeps: list[Sweep] = []
    for designed in full_design(robot, joint, POSES, sample_rate=250.0, blocks=("forward_slow", "backward_slow")):
        sweep = expected(designed, designed.spec.pose[index])
        record, pose = sweep.recording, sweep.spec.pose
        links = robot.chain.inertial.ravel() + body
        inertia = motor + float((inertia_rows(robot.chain, index, np.array([pose])) @ links)[0])
        friction = 200.0 * record.velocity + coulomb * np.sign(record.velocity)
        noise = random.normal(0, 3.0, len(record.time))
        (pulls,) = gravity_terms(robot.chain, links, robot.gravity, index, np.array([pose]))
        away = record.position - pose[index]
        gravity = pulls[0] * np.cos(away) + pulls[1] * np.sin(away)
        record.effort[:] = inertia * np.gradient(record.velocity, record.time) + friction + gravity + noise
        sweeps.append(sweep)
    return import_campaign(store, files, save_bundle(files, Bundle(robot, tuple(sweeps)))).id


class InProcess(DaskWorkers):
    """Does jobs at once and keeps them; fails as a worker process does."""

    def __init__(self) -> None:
        super().__init__(NOBODY)
        self.jobs: list[Work[Any]] = []

    async def run(self, job: Work[Answer]) -> Answer:
        self.jobs.append(job)
        try:
            return await asyncio.to_thread(job)
        except SweepidError as error:
            raise JobFailed(str(error)) from None


@dataclass
class Bench:
    store: Store
    files: RecordingFiles
    diagnoses: DiagnosisStore
    models: ModelStore
    diagnosing: Diagnosing

    async def over(self, diagnosis_id: int) -> DiagnosisDocument:
        ended = (DiagnosisState.DONE, DiagnosisState.FAILED)
        await until(lambda: self.diagnoses.diagnosis(diagnosis_id).state in ended, PATIENCE)
        return self.diagnoses.diagnosis(diagnosis_id)


@asynccontextmanager
async def open_bench(folder: Path, worker: Worker, place: ExperimentPlace | None = None) -> AsyncGenerator[Bench]:
    """`place`: where experiments would run."""
    async with AsyncExitStack() as stack:
        database = stack.enter_context(open_database(f"sqlite:///{folder / 'sweepid.sqlite'}"))
        store, files, diagnoses = Store(database), RecordingFiles(folder), DiagnosisStore(database)
        models = ModelStore(database)
        diagnosing = Diagnosing(store, diagnoses, models, files, worker, lambda _: place)
        stack.push_async_callback(diagnosing.close)
        yield Bench(store, files, diagnoses, models, diagnosing)


def axes_of(found: DiagnosisDocument | ModelDocument) -> Any:
    """The axes in a stored document, as the API has them."""
    assert found.document is not None
    return found.document["axes"]
