"""A runner on a real store and real files, in front of a machine whose samples come from a formula."""

import asyncio
import threading
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Generator, Iterator, Sequence
from contextlib import AbstractAsyncContextManager, AsyncExitStack, asynccontextmanager, contextmanager
from dataclasses import dataclass
from datetime import timedelta
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import text

from drivers.errors import Cause
from drivers.ports import SineCommand, SweepCommand, SweepMode
from service.jobs.dask_workers import DaskWorkers
from service.jobs.jobs import Jobs
from service.jobs.work import Worker
from service.machine.execution.energising import Approvals, Intention
from service.machine.execution.machine import Machine
from service.machine.execution.runner import Runner
from service.machine.execution.sweep_executor import SweepExecutor
from service.model import Robot, Sine, SweepSpec
from service.model.configuration import Cell, read_robot
from service.planning.campaigns.live import LiveHub
from service.planning.compiled_plan import CompiledPlan
from service.planning.safety.envelope_check import Envelope
from service.process.settings import Cluster
from service.store.database import Database, open_database
from service.store.diagnoses import ModelStore
from service.store.documents import CampaignDocument, NewSweep, SpectrumRecord, SweepDocument
from service.store.files.recordings import RecordingFiles
from service.store.lease_and_latch import ApprovalStore, MachineLease, StopLatch
from service.store.store import Store
from tests.unit.service.campaigns.formula_drive import FormulaDrive

ROOT = Path(__file__).parents[4]
POSES = ((0.0, 0.0, 0.0), (0.4, 0.0, 0.0), (0.4, 0.3, 0.0), (0.0, 0.3, -0.2))
SINES = ((2.0, 0.002, 0.3), (3.0, 0.0015, 1.1))
OFFSET, PERIODS, RAMP, SETTLE, RATE = 0.0105, 5, 0.3, 0.7, 250.0
TIMEOUT = 60.0  # s
LEASE_TIME = 0.5  # s
SPECTRUM = SpectrumRecord(path="s", sha256="0" * 64)  # where its content makes no difference
REACHED = ("joint_1", "joint_2", "joint_3")


@dataclass
class Bench:
    """What `serve` is made of, around a formula drive; identification is left to the tests that want it."""

    store: Store
    database: Database
    files: RecordingFiles
    drive: FormulaDrive
    machine: Machine
    jobs: Jobs
    runner: Runner
    hub: LiveHub
    campaign: CampaignDocument
    told: list[tuple[str, str]]
    """Way and why of the stops that latched nothing."""
    tell: Callable[[str, Cause], None]
    """Is told of them as well; a test may put another in its place."""
    compile_plan: Callable[[CampaignDocument], CompiledPlan]
    """What the runner asks; a test may put another in its place."""

    @property
    def intention(self) -> Intention:
        """Of a person who gives a command now."""
        return Intention(self.machine.epochs.now)

    @property
    def now(self) -> CampaignDocument:
        return self.store.campaign(self.campaign.id)

    async def start(self, **more: Any) -> CampaignDocument:
        return await self.runner.start(self.campaign.id, self.intention, **more)

    async def resume(self, **more: Any) -> CampaignDocument:
        return await self.runner.resume(self.campaign.id, self.intention, **more)

    async def in_a_sweep(self, block: int = 2, **more: Any) -> None:
        """Started, and held before this block of the first sweep until it is stopped or goes on."""
        self.drive.hold = block
        await self.start(**more)
        await asyncio.wait_for(self.drive.holding.wait(), TIMEOUT)

    def go_on(self) -> None:
        self.drive.hold = None
        self.drive.go.set()

    async def over(self) -> CampaignDocument:
        """Nothing runs any more, and no axis has energy."""
        await asyncio.wait_for(self.runner.finished(), TIMEOUT)
        assert self.runner.running is None
        assert self.drive.energised == set()
        return self.now


@pytest.fixture(scope="session")
def robot() -> Robot:
    return read_robot(ROOT / "config" / "robots" / "max100-class.yaml")


@pytest.fixture(scope="session")
def envelope(robot: Robot) -> Envelope:
    return Envelope(robot, Cell(name="empty"))


def spec(number: int, pose: Sequence[float]) -> SweepSpec:
    return SweepSpec(
        id=f"{number:04d}",
        axis="joint_1",
        pose=(*pose, 0.0, 0.0, 0.0),
        offset_velocity=OFFSET,
        sines=tuple(Sine(frequency=f, amplitude=a, phase=p) for f, a, p in SINES),
        period=1.0,
        periods=PERIODS,
        measure_from=RAMP + SETTLE,
        sample_rate=RATE,
    )


def command(sweep: SweepDocument) -> SweepCommand:
    start = sweep.spec.pose[0]
    return SweepCommand(
        joint="joint_1",
        mode=SweepMode.DRIVE_SIDE,
        offset_velocity=OFFSET,
        sines=tuple(SineCommand(f, a, p) for f, a, p in SINES),
        period=1.0,
        periods=PERIODS,
        ramp=RAMP,
        settle=SETTLE,
        sample_rate=RATE,
        velocity_limit=0.05,
        effort_limit=3000.0,
        position_window=(start - 0.004, start + 0.07),
    )


@asynccontextmanager
async def open_bench(
    folder: Path, robot: Robot, envelope: Envelope, worker: Worker | None = None
) -> AsyncGenerator[Bench]:
    """A bench with one planned campaign; without `worker`, jobs are taken but never done."""
    async with AsyncExitStack() as stack:
        database = stack.enter_context(open_database(f"sqlite:///{folder / 'sweepid.sqlite'}"))
        store, files, hub = Store(database), RecordingFiles(folder), LiveHub(100.0)
        drive = FormulaDrive(REACHED)
        latch = StopLatch(database)
        told: list[tuple[str, str]] = []

        def tell(way: str, cause: Cause) -> None:
            told.append((way, str(cause)))
            bench.tell(way, cause)

        machine = Machine(drive, latch, latch.latched(), tell=tell)
        models = ModelStore(database)
        jobs = Taken(store, files, models) if worker is None else Jobs(store, files, worker, models)
        stack.push_async_callback(jobs.close)
        executor = SweepExecutor(store, files, machine, hub)
        stack.callback(executor.close)

        def compile_plan(campaign: CampaignDocument) -> CompiledPlan:
            commands = {sweep.number: command(sweep) for sweep in store.sweeps(campaign.id)}
            return CompiledPlan(robot.joints, commands, envelope, move_velocity=0.1, pose_tolerance=2e-3)

        runner = Runner(
            store, machine, executor, jobs, lambda campaign: bench.compile_plan(campaign), nobody_needed(database)
        )
        stack.push_async_callback(runner.close)
        campaigns = store.campaigns()
        if not campaigns:
            plan = store.add_plan(store.add_robot(robot).id, {})
            new = [NewSweep(spec=spec(n, pose), mode=SweepMode.DRIVE_SIDE) for n, pose in enumerate(POSES, 1)]
            campaigns = (store.add_campaign(plan.id, new),)
        bench = Bench(
            store, database, files, drive, machine, jobs, runner, hub, campaigns[0], told, lambda *_: None, compile_plan
        )
        yield bench


def nobody_needed(database: Database) -> Approvals:
    """No plan needs an approval."""
    return Approvals(ApprovalStore(database), needed=False, valid=timedelta(hours=8))


class Taken(Jobs):
    """Jobs that are taken and never done."""

    def __init__(self, store: Store, files: RecordingFiles, models: ModelStore) -> None:
        super().__init__(store, files, DaskWorkers(Cluster("tcp://127.0.0.1:1")), models)
        self.sweeps: list[int] = []

    def submit(self, sweep: SweepDocument) -> None:
        self.sweeps.append(sweep.number)


Again = Callable[..., AbstractAsyncContextManager[Bench]]


@pytest.fixture
def again(tmp_path: Path, robot: Robot, envelope: Envelope) -> Again:
    """Opens the bench of this test's folder, as each process after another does."""
    return partial(open_bench, tmp_path, robot, envelope)


@pytest.fixture
async def bench(again: Again) -> AsyncIterator[Bench]:
    async with again() as bench:
        yield bench


@contextmanager
def refusing(bench: Bench, what: str = "INSERT ON event") -> Generator[None]:
    """The database refuses all events, or what is said."""
    with bench.database.write(quiet=True) as session:
        session.execute(text(f"CREATE TRIGGER full BEFORE {what} BEGIN SELECT RAISE(ABORT, 'disk is full'); END"))
    yield
    with bench.database.write(quiet=True) as session:
        session.execute(text("DROP TRIGGER full"))


@asynccontextmanager
async def keeping(
    bench: Bench, lease: MachineLease, lease_time: float = LEASE_TIME
) -> AsyncGenerator[asyncio.Task[None]]:
    """The machine's lease is renewed meanwhile."""
    keeper = asyncio.create_task(bench.machine.keep_lease(lease, lease_time))
    yield keeper
    keeper.cancel()
    await asyncio.wait([keeper])


class Barrier:
    """Whoever comes here waits until it is open."""

    def __init__(self) -> None:
        self.reached, self.opened = threading.Event(), threading.Event()

    def before(self, patch: pytest.MonkeyPatch, owner: object, name: str) -> None:
        """In front of a function or method."""
        work = getattr(owner, name)

        def held(*args: Any, **more: Any) -> Any:
            self.reached.set()
            assert self.opened.wait(TIMEOUT)
            return work(*args, **more)

        async def awaited(*args: Any) -> Any:
            self.reached.set()
            await until(self.opened.is_set)
            return await work(*args)

        patch.setattr(owner, name, awaited if asyncio.iscoroutinefunction(work) else held)


@pytest.fixture
def barrier() -> Iterator[Barrier]:
    """Opened at the end."""
    barrier = Barrier()
    yield barrier
    barrier.opened.set()


async def until_cancelled(campaign_id: int) -> None:
    """Until somebody has asked the task that runs a campaign to end."""
    name = f"campaign {campaign_id}"
    await until(lambda: any(task.get_name() == name and task.cancelling() for task in asyncio.all_tasks()))


async def until(condition: Callable[[], bool], within: float = TIMEOUT) -> None:
    """Wait for a condition that comes from another process or thread; TimeoutError if it does not come."""
    async with asyncio.timeout(within):
        while not condition():  # noqa: ASYNC110
            await asyncio.sleep(0.01)
