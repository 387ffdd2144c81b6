"""The composition root: builds store, machine, runner, worker and hub from the settings, and owns their lifetimes."""

import asyncio
from collections.abc import AsyncGenerator, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from datetime import timedelta
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import structlog

from drivers.errors import DriveError
from drivers.registry import load_profile, open_drive
from service.campaigns.live import EventFeed, LiveHub
from service.configuration import read_robot
from service.diagnosis.effects import CATALOGUE
from service.diagnosis_loop.acceptance import accept_model
from service.diagnosis_loop.diagnosing import Diagnosing
from service.diagnosis_loop.experiments import Experiments
from service.errors import Conflict
from service.execution.approvals import Approvals
from service.execution.machine import Machine
from service.execution.recording.recovery import recover
from service.execution.runner import Runner
from service.execution.second_stop import listening, watching
from service.execution.sweep_executor import SweepExecutor
from service.geometry.cell import read_cell
from service.jobs.checking import Checking
from service.jobs.jobs import Jobs
from service.jobs.reporting import Reporting
from service.people.chain import Entry
from service.people.keys import masked
from service.planning.compiled_plan import compile_plan, plan_of, planned_sweeps
from service.planning.motion_hash import machine_sha256, motion_sha256
from service.report import Form, NoPdf
from service.safety.robot_and_machine import DriveAxis, DriveProfile
from service.settings import Settings
from service.stop_process.handle import StopProcess
from service.store.approvals import ApprovalStore
from service.store.checks import CheckStore
from service.store.database import open_database
from service.store.diagnosis.diagnoses import DiagnosisStore
from service.store.diagnosis.model_revisions import ModelStore
from service.store.diagnosis_documents import ModelDocument
from service.store.documents import CampaignDocument
from service.store.files.apart import LIMITS, Limits, read_apart
from service.store.files.bundle import write_bundle
from service.store.files.data_folder import claim_folder
from service.store.files.exchange import campaign_bundle, import_campaign
from service.store.files.intake import SavedBundle, take_in
from service.store.files.recordings import RecordingFiles
from service.store.guards import MachineLease, StopLatch
from service.store.people.audit import AuditStore
from service.store.people.keys import KeyStore
from service.store.people.sessions import SessionStore
from service.store.people.users import UserStore
from service.store.people.writer import AuditWriter
from service.store.requests import IdempotencyKeys
from service.store.store import Store
from service.tasks.background import Background
from service.worker import Worker, Written, open_worker

_log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class Application:
    """Everything that `sweepid serve` is made of."""

    settings: Settings
    drive_axes: tuple[DriveAxis, ...]  # as the profile has them
    store: Store
    files: RecordingFiles
    keys: IdempotencyKeys
    machine: Machine
    runner: Runner
    jobs: Jobs
    worker: Worker
    hub: LiveHub
    feed: EventFeed
    diagnoses: DiagnosisStore
    models: ModelStore
    diagnosing: Diagnosing
    experiments: Experiments
    checks: CheckStore
    checking: Checking
    stop_process: StopProcess | None
    audit: AuditWriter
    api_keys: KeyStore
    users: UserStore
    sessions: SessionStore
    approvals: Approvals
    machine_sha256: str  # of the drive profile with its files, as they are used
    lost: str
    """Why nothing may be stored, because the database is not the one of the data folder; empty if it is."""

    async def troubles(self) -> tuple[str, ...]:
        """Why nothing can be measured now, or why what was measured is not identified; one line each."""
        process = self.stop_process
        found = [
            self.lost,
            "" if self.machine.connected else f"machine not connected: {self.machine.trouble or 'not tried yet'}",
            self.machine.forbidden,
            process.trouble if process is not None and process.ended else "",
            await asyncio.to_thread(self.files.disk_trouble, self.settings.least_free_disk),
            self.worker.trouble,
            self.runner.untold,
            *self.jobs.troubles,
            *self.checking.troubles,
            *self.diagnosing.troubles,
        ]
        return tuple(line for line in found if line)

    async def add_campaign(self, plan_id: int) -> CampaignDocument:
        """A campaign of a stored plan, in state `planned`. Nothing moves until `runner.start`."""
        self._check_database()
        plan = await asyncio.to_thread(self.store.plan, plan_id)
        return await asyncio.to_thread(self.store.add_campaign, plan_id, planned_sweeps(plan))

    def motion_sha256(self, plan_id: int) -> str:
        """Of all that decides what a plan moves now (see `motion_hash`); blocks."""
        plan = self.store.plan(plan_id)
        cell = read_cell(self.settings.cells_dir / f"{plan_of(plan).request.cell}.yaml")
        return motion_sha256(plan, self.store.robot(plan.robot_id), cell, self.settings, self.machine_sha256)

    async def import_bundle(self, source: Path, limits: Limits = LIMITS) -> CampaignDocument:
        """A campaign of the sweeps of a bundle (folder or zip), which are then identified. BadInput: nothing is stored.

        It is read by another process: within `limits`, and no sample of it comes here.
        """
        self._check_database()
        with TemporaryDirectory(prefix="import-", dir=self.files.transfer()) as name:
            work = Path(name)
            saved = SavedBundle.model_validate(await read_apart(take_in, (source, work), "bundle", limits))
            campaign = await asyncio.to_thread(self._add_imported, work, saved)
        for sweep in await asyncio.to_thread(self.store.sweeps, campaign.id):
            self.jobs.submit(sweep)
        return campaign

    async def export_bundle(self, campaign_id: int, folder: Path) -> None:
        """Write the completely recorded sweeps of a campaign as a bundle. Conflict if there are none."""
        bundle = await asyncio.to_thread(campaign_bundle, self.store, self.files, campaign_id)
        await asyncio.to_thread(write_bundle, folder, bundle.robot, bundle.sweeps)

    def _add_imported(self, work: Path, saved: SavedBundle) -> CampaignDocument:
        self.files.take_over(work, saved.folder)
        return import_campaign(self.store, self.files, saved)

    async def campaign_report(self, campaign_id: int, form: Form) -> str | bytes:
        """Drawn by the worker; Conflict while nothing is identified, NoPdf where PDF cannot be made."""
        reporting = Reporting(self.store, self.diagnoses, self.checks, self.files)
        return _made(await self.worker.run(await asyncio.to_thread(reporting.job, campaign_id, form)))

    async def diagnosis_report(self, diagnosis_id: int, form: Form) -> str | bytes:
        """The same of a diagnosis; Conflict until it is done."""
        reporting = Reporting(self.store, self.diagnoses, self.checks, self.files)
        return _made(await self.worker.run(await asyncio.to_thread(reporting.of_diagnosis, diagnosis_id, form)))

    def _check_database(self) -> None:
        if self.lost:
            raise Conflict(self.lost)

    def accept_model(self, diagnosis_id: int, axes: Sequence[str] | None, accepted_by: str) -> ModelDocument:
        """A diagnosis becomes the next revision of its robot's model (see `acceptance`); blocks."""
        return accept_model(self.store, self.diagnoses, self.models, diagnosis_id, axes, accepted_by)


def _made(written: Written) -> str | bytes:
    if isinstance(written, NoPdf):
        raise written
    return written


@asynccontextmanager
async def open_application(settings: Settings, stop_process: StopProcess | None = None) -> AsyncGenerator[Application]:
    """Open everything; MachineTaken when another service owns the machine, BadInput or BadProfile for a bad file
    or an installed effect that cannot be used.

    A machine that does not answer is no error here: the service starts, `machine.trouble` tells it, and connecting
    is tried again on command. After a restart nothing moves (`recovery.recover`); connecting disables every axis.
    """
    async with AsyncExitStack() as stack:
        if brought := CATALOGUE.brought:
            _log.info("effects_of_other_packages", packages=brought)
        profile = load_profile(settings.drive)
        port = open_drive(profile, settings.drive.parent)
        axes = DriveProfile.model_validate(profile).of(port.joints)
        machine_hash = machine_sha256(profile, settings.drive.parent)
        settings.data_dir.mkdir(parents=True, exist_ok=True)
        database = stack.enter_context(open_database(settings.url))
        api_keys = KeyStore(database)
        users, sessions = UserStore(database), SessionStore(database, settings.session_idle, settings.session_longest)
        audit = stack.enter_context(AuditWriter(AuditStore(database), api_keys, sessions))
        store, files, keys = Store(database), RecordingFiles(settings.data_dir), IdempotencyKeys(database)

        lost = await asyncio.to_thread(claim_folder, settings.data_dir, database)
        if lost:
            _log.error("database_lost", reason=lost)
        lease = MachineLease(database, settings.lease_time)
        await asyncio.to_thread(lease.acquire)
        stack.callback(lease.release)
        latch = StopLatch(database)
        order_stop = (lambda: None) if stop_process is None else stop_process.order
        machine = Machine(port, latch, latch.latched(), order_stop, partial(tell_own_stop, audit))
        stack.push_async_callback(machine.close)
        stack.push_async_callback(port.close)
        keeping = Background()
        stack.push_async_callback(keeping.close)
        keeping.begin("lease", machine.keep_lease(lease, settings.lease_time))
        await stack.enter_async_context(watching(machine, partial(tell_own_stop, audit)))
        if stop_process is not None:
            await stack.enter_async_context(listening(stop_process, machine, partial(_tell_stop, audit)))

        if not lost:
            await asyncio.to_thread(files.clear_transfer)
            for number in await asyncio.to_thread(recover, store, files):
                tell_own_stop(audit, f"campaign {number}", "the service before this one ended without a word")
        keys.release_unanswered()
        for path in sorted(settings.robots_dir.glob("*.yaml")):
            store.add_robot(read_robot(path))

        feed, hub = EventFeed(store, database), LiveHub(settings.live_rate)
        stack.callback(feed.close)
        stack.callback(hub.close)
        worker = await stack.enter_async_context(open_worker(settings.dask_scheduler))
        diagnoses, models = DiagnosisStore(database), ModelStore(database)
        jobs = Jobs(store, files, worker, models)
        stack.push_async_callback(jobs.close)
        executor = SweepExecutor(store, files, machine, hub)
        stack.callback(executor.close)
        approvals = Approvals(ApprovalStore(database), settings.approval, timedelta(hours=settings.approval_valid))
        compiling = partial(compile_plan, store, settings, axes, machine_hash)
        runner = Runner(store, machine, executor, jobs, compiling, approvals)
        stack.push_async_callback(runner.close)

        diagnosing = Diagnosing(store, diagnoses, models, files, worker)
        stack.push_async_callback(diagnosing.close)
        experiments = Experiments(settings, store, diagnoses, runner, diagnosing)
        stack.push_async_callback(experiments.close)
        told = await asyncio.to_thread(store.last_event_id)
        await diagnosing.recover()
        await experiments.recover()
        checks = CheckStore(database)
        checking = Checking(store, checks, files, worker)
        stack.push_async_callback(checking.close)
        await checking.recover()
        following = Background()
        stack.push_async_callback(following.close)
        following.begin("check of the data", checking.follow(feed, told))
        following.begin("loop of the diagnoses", experiments.follow(feed, told))

        await jobs.recover()
        try:
            await machine.connect()
        except DriveError as error:
            _log.warning("machine_not_connected", reason=str(error))
        yield Application(
            *(settings, axes, store, files, keys, machine, runner, jobs, worker, hub, feed),
            *(diagnoses, models, diagnosing, experiments, checks, checking, stop_process, audit),
            *(api_keys, users, sessions, approvals, machine_hash, lost),
        )


def _tell_stop(audit: AuditWriter, by: str, why: str, address: str) -> None:
    """A stop by the port of the stop process, which asks nobody who he is: `by` is what he says."""
    told: Entry = {"actor": "anybody", "address": address, "by": masked(by), "why": masked(why)}
    audit.keep({"event": "stop", "way": "stop process", **told})


def tell_own_stop(audit: AuditWriter, way: str, why: str) -> None:
    """A stop by the service itself, which is nobody's: host watch, lease, end of the service, a campaign's trouble."""
    audit.keep({"event": "stop", "way": way, "actor": way, "by": way, "why": masked(why)})
