"""The composition root: builds store, machine, runner, worker and hub from the settings, and owns their lifetimes."""

import asyncio
from collections.abc import AsyncGenerator, Awaitable, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, replace
from datetime import timedelta
from functools import cached_property, lru_cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import structlog

from drivers.errors import Cause, CauseCode, DriveError
from drivers.registry import open_profile
from service import BadInput, Conflict
from service.diagnosis.effects import CATALOGUE
from service.jobs.diagnosing import Diagnosing
from service.jobs.experiments import ExperimentPlanner, Experiments
from service.jobs.jobs import Batches, Checking, Jobs
from service.jobs.recording_uploads import RecordingUploads, Transfers
from service.jobs.worker import Worker, open_worker
from service.machine.execution.energising import Approvals
from service.machine.execution.machine import Machine, listening, watching
from service.machine.execution.runner import Runner
from service.machine.execution.statement import Condition
from service.machine.execution.sweep_executor import SweepExecutor
from service.machine.execution.sweep_samples import recover
from service.machine.stop_process.handle import StopProcess
from service.model.configuration import read_robot
from service.planning.campaigns.live import EventFeed, LiveHub
from service.planning.campaigns.stored_plan import PlannedTime, PlanSubject, plan_subject, planned_times
from service.planning.campaigns.stored_results import FleetHistory, Quality, quality_of
from service.planning.compiled_plan import compile_plan, planned_sweeps
from service.planning.machine_setup import MachineSetup, machine_setup
from service.process.settings import Settings
from service.process.tasks import Background
from service.process.telemetry import traced
from service.publishing.following import Following
from service.publishing.publisher import Publisher
from service.publishing.state import Configuration
from service.store.access import masked
from service.store.database import Database, open_database
from service.store.diagnoses import DiagnosisStore, ModelStore
from service.store.documents import CampaignDocument, RobotDocument
from service.store.files.bundle import SavedBundle, take_in, write_bundle
from service.store.files.data_folder import campaign_bundle, claim_folder, import_campaign
from service.store.files.isolated_reader import LIMITS, Limits, read_isolated
from service.store.files.recordings import RecordingFiles
from service.store.lease_and_latch import ApprovalStore, IdempotencyKeys, MachineLease, StopLatch
from service.store.objects import check_usable
from service.store.people.audit import AuditStore, AuditWriter, Entry
from service.store.people.users import (
    ExternalUsers,
    KeyStore,
    SessionStore,
    UserStore,
    begin_time,
    keeping_time_and_head,
)
from service.store.plant import BatchStore, FleetStore, PlantStore
from service.store.retention import MoveStore
from service.store.store import CheckStore, Store
from service.store.table_rows import NoMachine


@dataclass(frozen=True)
class MachineCell:
    """The machine of a service, and the parts that move it or compute from its recordings."""

    setup: MachineSetup
    lost: str
    """Reason why nothing may be stored: the database does not belong to the data folder; empty if it does."""
    machine: Machine
    jobs: Jobs
    executor: SweepExecutor
    runner: Runner
    approvals: Approvals
    diagnosing: Diagnosing
    experiments: Experiments
    checking: Checking
    batches: Batches
    moving: RecordingUploads | None  # None: recordings stay in the data folder
    publisher: Publisher | None  # None: neither OPC UA nor MQTT
    stop_process: StopProcess | None

    def _unknown(self) -> str:
        statement = self.machine.statement
        unknown = self.machine.connected and statement.state is Condition.UNKNOWN
        return f"the state of the machine is unknown: {statement.reason}" if unknown else ""

    async def troubles(self, files: RecordingFiles, least_free_disk: int) -> tuple[str, ...]:
        """Reasons why no measurement or identification is possible now; "" for each part that works."""
        process = self.stop_process
        await self.machine.ask()
        return (
            self.lost,
            "" if self.machine.connected else f"machine not connected: {self.machine.trouble or 'not tried yet'}",
            self._unknown(),
            self.machine.forbidden,
            "" if process is None else process.failed,
            await asyncio.to_thread(files.disk_trouble, least_free_disk),
            self.runner.unstored,
            *self.jobs.troubles,
            *self.checking.troubles,
            *self.diagnosing.troubles,
            *self.batches.troubles,
        )


_log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class Application:
    """All parts of `sweepid serve`. `cell`: None for a service that only reads the data of the plant."""

    settings: Settings
    store: Store
    files: RecordingFiles
    keys: IdempotencyKeys
    worker: Worker
    hub: LiveHub
    feed: EventFeed
    diagnoses: DiagnosisStore
    models: ModelStore
    checks: CheckStore
    audit: AuditWriter
    api_keys: KeyStore
    users: UserStore
    sessions: SessionStore
    external_users: ExternalUsers
    fleet_history: FleetHistory
    plant: PlantStore
    batches: BatchStore
    cell: MachineCell | None

    @property
    def own(self) -> MachineCell:
        """The cell; NoMachine if there is none."""
        if self.cell is None:
            raise NoMachine
        return self.cell

    @property
    def machine(self) -> Machine:
        return self.own.machine

    @property
    def runner(self) -> Runner:
        return self.own.runner

    @cached_property
    def planned_times(self) -> Callable[[int], tuple[PlannedTime, ...]]:
        """Planned times by plan number; a stored plan never changes, so each is read once. Blocks."""

        @lru_cache(maxsize=8)
        def times(plan_id: int) -> tuple[PlannedTime, ...]:
            return planned_times(self.store.plan(plan_id))

        return times

    @cached_property
    def subjects(self) -> Callable[[int], PlanSubject]:
        """Robot, cell and machine by plan number, as `planned_times`. Blocks."""

        @lru_cache(maxsize=256)
        def subject(plan_id: int) -> PlanSubject:
            plan = self.store.plan(plan_id)
            return plan_subject(plan.robot_id, plan.document)

        return subject

    @cached_property
    def qualities(self) -> Callable[[], dict[str, Quality]]:
        """Quality of the latest estimate of each robot, by name; revisions never change, so each is read once. Blocks.

        An estimate of another version is omitted, with an entry in the log.
        """

        @lru_cache(maxsize=256)
        def of_revision(campaign_id: int, revision: int) -> Quality | None:
            try:
                return quality_of(self.store.estimate(campaign_id, revision))
            except BadInput as error:
                _log.warning("estimate_without_quality", campaign=campaign_id, revision=revision, reason=str(error))
                return None

        def latest() -> dict[str, Quality]:
            newest = self.store.latest_estimates().items()
            found = {name: of_revision(one.campaign_id, one.revision) for name, one in newest}
            return {name: one for name, one in found.items() if one is not None}

        return latest

    async def troubles(self) -> tuple[str, ...]:
        """Reasons why no measurement or no identification is possible now; one line each.

        Without a machine: the reason why no report can be drawn.
        """
        own = () if self.cell is None else await self.cell.troubles(self.files, self.settings.least_free_disk)
        return tuple(line for line in (*own, self.worker.trouble) if line)

    async def add_campaign(self, plan_id: int) -> CampaignDocument:
        """A campaign of a stored plan, in state `planned`. Nothing moves until `runner.start`."""
        self._check_database()
        plan = await asyncio.to_thread(self.store.plan, plan_id)
        return await asyncio.to_thread(self.store.add_campaign, plan_id, planned_sweeps(plan))

    async def import_bundle(self, source: Path, limits: Limits = LIMITS) -> CampaignDocument:
        """A campaign of the sweeps of a bundle (folder or zip), to be identified. BadInput: nothing is stored.

        Another process reads the bundle within `limits`; its samples are not loaded in this process.
        """
        self._check_database()
        with TemporaryDirectory(prefix="import-", dir=self.files.transfer()) as name:
            work = Path(name)
            saved = SavedBundle.model_validate(await read_isolated(take_in, (source, work), "bundle", limits))
            campaign = await asyncio.to_thread(self._add_imported, work, saved)
        await self.own.jobs.submit_imported(campaign.id)
        return campaign

    async def export_bundle(self, campaign_id: int, folder: Path) -> None:
        """Write the completely recorded sweeps of a campaign as a bundle. Conflict if there are none."""
        bundle = await asyncio.to_thread(campaign_bundle, self.store, self.files, campaign_id)
        await asyncio.to_thread(write_bundle, folder, bundle.robot, bundle.sweeps)

    def _add_imported(self, work: Path, saved: SavedBundle) -> CampaignDocument:
        self.files.take_over(work, saved.folder)
        return import_campaign(self.store, self.files, saved)

    def _check_database(self) -> None:
        if self.own.lost:
            raise Conflict(self.own.lost)


def _add_robots(store: Store, folder: Path) -> dict[str, RobotDocument]:
    return {path.stem: store.add_robot(read_robot(path)) for path in sorted(folder.glob("*.yaml"))}


@asynccontextmanager
async def open_application(settings: Settings, stop_process: StopProcess | None = None) -> AsyncGenerator[Application]:
    """Open everything; MachineTaken if another service owns the machine, BadInput or BadProfile for an invalid file
    or an installed effect that cannot be used.

    A machine that does not answer is no error here: the service starts, `machine.trouble` has the reason, and a command
    can connect again. After a restart nothing moves (`recovery.recover`); connecting disables every axis.
    With the setting `no_machine` there is neither drive nor lease, and the service writes only the audit
    and sessions of the plant.
    """
    async with AsyncExitStack() as stack:
        stack.enter_context(traced(settings.traces, settings.machine_name))
        if brought := CATALOGUE.brought:
            _log.info("effects_of_other_packages", packages=brought)
        profile, port = (None, None) if settings.no_machine else open_profile(settings.drive)
        settings.data_dir.mkdir(parents=True, exist_ok=True)
        name = None if settings.no_machine else settings.machine_name
        database = stack.enter_context(
            open_database(settings.url, settings.database_password_file, name, migrated=not settings.no_machine)
        )
        await asyncio.to_thread(begin_time, database)
        api_keys = KeyStore(database)
        users, sessions = UserStore(database), SessionStore(database, settings.session_idle, settings.session_longest)
        entries, each_minute = AuditStore(database), keeping_time_and_head(database, settings.audit_heads_file)
        audit = stack.enter_context(AuditWriter(entries, api_keys, sessions, each_minute=each_minute))
        store, keys = Store(database), IdempotencyKeys(database)
        address = settings.recordings_store
        transfers = None
        if address is not None:
            check_usable(address)
            transfers = Transfers()
            stack.push_async_callback(transfers.close)
        files = RecordingFiles(settings.data_dir, address, None if transfers is None else transfers.fetch)
        owned, setup, keeping = None, None, Background()
        if port is not None:
            owned = await _own_machine(
                stack, settings, database, partial(Machine, port), port.close, stop_process, audit, keeping
            )
            if not owned.lost:
                await asyncio.to_thread(files.clear_transfer)
                died = Cause(CauseCode.SERVICE_ENDED, detail="the previous service process ended without a shutdown")
                for number in await asyncio.to_thread(recover, store, files):
                    tell_own_stop(audit, f"campaign {number}", died)
            keys.release_unanswered()
            robots = await asyncio.to_thread(_add_robots, store, settings.robots_dir)  # the host watch has begun
            setup = machine_setup(settings, profile, owned.machine.joints, robots)
        else:
            stack.push_async_callback(keeping.close)

        feed, hub = EventFeed(store, database), LiveHub(settings.live_rate)
        stack.callback(feed.close)
        keeping.begin("events of other services", feed.watch())
        stack.callback(hub.close)
        worker = await stack.enter_async_context(open_worker(settings.cluster, settings.traces, settings.machine_name))
        diagnoses, models = DiagnosisStore(database), ModelStore(database)
        application = Application(
            *(settings, store, files, keys, worker, hub, feed, diagnoses, models, CheckStore(database), audit),
            *(api_keys, users, sessions, ExternalUsers(database)),
            *(FleetHistory(FleetStore(database)), PlantStore(database), BatchStore(database), None),
        )
        if owned is not None and setup is not None:
            if not owned.lost:
                application.plant.configure(None if setup.robot is None else setup.robot.id, setup.cell)
            cell = await _open_cell(stack, application, database, owned, setup, transfers, stop_process)
            application = replace(application, cell=cell)
        yield application


class _Owned(NamedTuple):
    machine: Machine
    lost: str


async def _own_machine(
    stack: AsyncExitStack,
    settings: Settings,
    database: Database,
    make: Callable[..., Machine],
    close_port: Callable[[], Awaitable[None]],
    stop_process: StopProcess | None,
    audit: AuditWriter,
    keeping: Background,
) -> _Owned:
    """Take the data folder and the lease for this service; the machine is not connected yet.

    `make` creates it from its latch, the active stops, and the callback for stops; `close_port` ends its connection.
    """
    lost = await asyncio.to_thread(claim_folder, settings.data_dir, database)
    if lost:
        _log.error("database_lost", reason=lost)
    lease = MachineLease(database, settings.lease_time)
    await asyncio.to_thread(lease.acquire)
    stack.callback(lease.release)
    latch = StopLatch(database)
    order_stop = (lambda: None) if stop_process is None else stop_process.order
    machine = make(latch, latch.latched(), order_stop, partial(tell_own_stop, audit))
    stack.push_async_callback(machine.close)
    stack.push_async_callback(close_port)
    stack.push_async_callback(keeping.close)
    keeping.begin("lease", machine.keep_lease(lease, settings.lease_time))
    await stack.enter_async_context(watching(machine, partial(tell_own_stop, audit)))
    if stop_process is not None:
        await stack.enter_async_context(listening(stop_process, machine, partial(_tell_stop, audit)))
    return _Owned(machine, lost)


async def _open_cell(
    stack: AsyncExitStack,
    app: Application,
    database: Database,
    owned: _Owned,
    setup: MachineSetup,
    transfers: Transfers | None,
    stop_process: StopProcess | None,
) -> MachineCell:
    """The parts that move the machine and compute; open jobs continue, and the machine is connected if it answers."""
    settings, store, files, worker, machine = app.settings, app.store, app.files, app.worker, owned.machine
    jobs = Jobs(store, files, worker, app.models)
    stack.push_async_callback(jobs.close)
    executor = SweepExecutor(store, files, machine, app.hub)
    stack.callback(executor.close)
    approvals = Approvals(ApprovalStore(database), settings.approval, timedelta(hours=settings.approval_valid))
    runner = Runner(store, machine, executor, jobs, partial(compile_plan, store, settings, setup), approvals)
    stack.push_async_callback(runner.close)

    planner = ExperimentPlanner(settings, store, setup)
    diagnosing = Diagnosing(store, app.diagnoses, app.models, files, worker, planner.place)
    stack.push_async_callback(diagnosing.close)
    experiments = Experiments(settings, store, app.diagnoses, runner, diagnosing, planner)
    stack.push_async_callback(experiments.close)
    last_event = await asyncio.to_thread(store.last_event_id)
    await diagnosing.recover()
    await experiments.recover()
    checking = Checking(store, app.checks, files, worker)
    stack.push_async_callback(checking.close)
    await checking.recover()
    batches = Batches(store, app.batches, app.models, files, worker)
    stack.push_async_callback(batches.close)
    await batches.recover()
    following = Background()
    stack.push_async_callback(following.close)
    following.begin("end of the identification", jobs.follow(app.feed, last_event))
    following.begin("check of the data", checking.follow(app.feed, last_event))
    following.begin("loop of the diagnoses", experiments.follow(app.feed, last_event))
    moving = None
    if transfers is not None:
        moving = RecordingUploads(MoveStore(database), files, settings, transfers)
        if not owned.lost:
            following.begin("move recordings", moving.follow())

    publication = Configuration.of(settings)
    publisher = None if publication is None else Publisher(publication)
    if publisher is not None:
        published = Following(store, machine, runner, settings.machine_name, publisher)
        following.begin("publisher", publisher.run())
        following.begin("publish the machine", published.look())
        following.begin("publish events", published.follow(app.feed, last_event))

    await jobs.recover()
    try:
        await machine.connect()
    except DriveError as error:
        _log.warning("machine_not_connected", reason=str(error))
    return MachineCell(
        *(setup, owned.lost, machine, jobs, executor, runner, approvals),
        *(diagnosing, experiments, checking, batches, moving, publisher, stop_process),
    )


def _tell_stop(audit: AuditWriter, by: str, why: str, address: str) -> None:
    """A stop by the port of the stop process, which has no login: `by` is the name in the request."""
    stop: Entry = {"actor": "anybody", "address": address, "by": masked(by), "why": masked(why)}
    audit.keep({"event": "stop", "way": "stop process", **stop})


def tell_own_stop(audit: AuditWriter, way: str, cause: Cause) -> None:
    """A stop by the service itself, without a user: host watch, lease, end of the service, a campaign's trouble."""
    told: Entry = {"why": masked(str(cause)), "code": cause.code, "joint": cause.joint}
    audit.keep({"event": "stop", "way": way, "actor": way, "by": way, **told})
