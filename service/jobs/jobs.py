"""Open jobs of the store: identification of recorded sweeps, data check of a campaign, re-identification, payloads.

The store is the outbox: a job is open while its row has no result; open jobs are found again after a restart. Each runs
in a task of its own, is repeated if the store or the disk fails, and must be repeatable, as after a restart.
"""

import asyncio
import hashlib
import json
from collections import defaultdict
from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from functools import partial

import structlog
from sqlalchemy.exc import OperationalError
from structlog.contextvars import bound_contextvars

from drivers.errors import Cause, CauseCode
from service import BadInput, NotFound, NotNow
from service.jobs.work import (
    CheckJob,
    Job,
    JobFailed,
    PayloadJob,
    RecordedSweep,
    ReidentifyJob,
    Worker,
    WorkerLost,
)
from service.planning.campaigns.live import EventFeed
from service.planning.campaigns.state_machine import CampaignEvent, SweepEvent, campaign_move, sweep_move
from service.planning.campaigns.stored_results import analysis_behind, campaign_beside, siblings_behind
from service.process.telemetry import TRACING
from service.store.database import refusal
from service.store.diagnoses import ModelStore
from service.store.documents import (
    BatchState,
    CampaignDocument,
    CampaignState,
    EstimateDocument,
    EventKind,
    RecordingDocument,
    SweepDocument,
    SweepState,
)
from service.store.files.recordings import RecordingFiles
from service.store.plant import BatchDocument, BatchStore, PayloadDocument
from service.store.store import COMPLETE, OVER, CheckStore, Store

_log = structlog.get_logger(__name__)


class OpenJobs:
    """The open jobs of one kind; each kind derives from it."""

    def __init__(self) -> None:
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._sizes: dict[str, int] = {}
        self._troubles: dict[str, str] = {}

    @property
    def open(self) -> int:
        """How many items wait or run: the sum of the sizes of the open jobs."""
        return sum(self._sizes.values())

    @property
    def troubles(self) -> tuple[str, ...]:
        """Why a job waits although a worker is available, or was aborted until a restart; one line per job."""
        return tuple(f"{name}: {why}" for name, why in self._troubles.items())

    def begin(
        self,
        name: str,
        do: Callable[[], Awaitable[None]],
        turn: asyncio.Lock | None = None,
        size: int = 1,
        **about: int,
    ) -> None:
        """Run `do` in a task of its own; no effect if a task with this name is open.

        Tasks with the same `turn` run one after the other, in the order of the calls. `size`: number of its items.
        `about`: fields of its log lines, such as its campaign.
        """
        if name not in self._tasks:
            self._troubles.pop(name, None)
            self._sizes[name] = size
            task = asyncio.create_task(self._keep(name, do, turn, about), name=name)
            self._tasks[name] = task
            task.add_done_callback(partial(self._done, about))

    def end(self, name: str) -> None:
        """Cancel the task with this name, if it is open; data that it has stored are kept."""
        task = self._tasks.get(name)
        if task is not None:
            task.cancel()

    async def close(self) -> None:
        """Cancel all tasks; the next process continues the open jobs."""
        tasks = list(self._tasks.values())
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _keep(
        self, name: str, do: Callable[[], Awaitable[None]], turn: asyncio.Lock | None, about: Mapping[str, int]
    ) -> None:
        with bound_contextvars(**about):
            async with turn or nullcontext():
                await self._patiently(name, do)

    async def _patiently(self, name: str, do: Callable[[], Awaitable[None]]) -> None:
        while True:
            try:
                await do()
            except (OperationalError, OSError, NotNow) as error:  # locked, full, read-only, unreachable: temporary
                reason = refusal(error) if isinstance(error, OperationalError) else str(error).partition("\n")[0]
                _log.warning("job_waits", job=name, reason=reason)
                self._troubles[name] = reason
                await asyncio.sleep(2.0)
            else:
                self._troubles.pop(name, None)
                return

    def _done(self, about: Mapping[str, int], task: asyncio.Task[None]) -> None:
        name = task.get_name()
        del self._tasks[name], self._sizes[name]
        if not task.cancelled() and (error := task.exception()) is not None:
            # nothing was written: the next start repeats it
            self._troubles[name] = f"failed; it is repeated at the next start of the service: {error!r}"
            _log.error("job_broke_off", job=name, exc_info=error, **about)


FOLLOWS = (SweepState.PLANNED, SweepState.RUNNING, SweepState.RECORDED)  # a sweep in them may follow a revision
MOST_REVISIONS = 60  # points of a convergence chart; with 900 sweeps their estimates take 13 s of processor time


class Jobs(OpenJobs):
    """Submits recorded sweeps to the worker and writes its results."""

    def __init__(self, store: Store, files: RecordingFiles, worker: Worker, models: ModelStore) -> None:
        super().__init__()
        self._store, self._files, self._worker, self._models = store, files, worker, models
        self._turn: defaultdict[int, asyncio.Lock] = defaultdict(asyncio.Lock)  # by campaign, first in first out

    async def recover(self) -> None:
        """Submit the jobs that the last process left open."""
        for campaign in await asyncio.to_thread(self._store.campaigns_in, CampaignState.MEASURED):
            await self.settle(campaign.id)
        imported: set[int] = set()
        for sweep in await asyncio.to_thread(self._store.sweeps_in, SweepState.RECORDED):
            if sweep.mode is not None:
                self.submit(sweep)
            elif sweep.campaign_id not in imported:
                imported.add(sweep.campaign_id)
                await self.submit_imported(sweep.campaign_id)

    def submit(self, sweep: SweepDocument) -> None:
        """Identify a recorded sweep; returns immediately."""
        name = f"identification of campaign {sweep.campaign_id} sweep {sweep.number} attempt {sweep.attempt}"
        turn = self._turn[sweep.campaign_id]
        do = partial(self._do, (sweep,))
        self.begin(name, do, turn, campaign=sweep.campaign_id, sweep=sweep.number)

    async def submit_imported(self, campaign_id: int) -> None:
        """Identify the recorded sweeps of an imported campaign; returns before they are identified."""
        for group in open_groups(await asyncio.to_thread(self._store.sweeps, campaign_id)):
            if len(group) == 1:
                self.submit(group[0])
                continue
            name = f"identification of campaign {campaign_id} sweeps {group[0].number} to {group[-1].number}"
            turn = self._turn[campaign_id]
            self.begin(name, partial(self._do, group), turn, len(group), campaign=campaign_id)

    async def settle(self, campaign_id: int) -> None:
        """measured -> completed, if no sweep is left to identify and the estimate is a fit of all sweeps."""
        campaign = await asyncio.to_thread(self._store.campaign, campaign_id)
        if campaign.state not in OVER or SweepState.RECORDED in campaign.sweeps:
            return
        if await asyncio.to_thread(self._updated, campaign_id) is not None:
            do, turn = partial(self._fit_all, campaign_id), self._turn[campaign_id]
            self.begin(f"identification of campaign {campaign_id}", do, turn, campaign=campaign_id)
        else:
            await self._complete(campaign)

    async def _complete(self, campaign: CampaignDocument) -> None:
        if campaign.state is CampaignState.MEASURED:
            identified = campaign_move(CampaignEvent.IDENTIFIED)
            cause = campaign.structured_cause
            await asyncio.to_thread(self._store.move_campaign, campaign.id, identified, cause)

    async def follow(self, feed: EventFeed, after: int) -> None:
        """Settle each campaign of this machine that is aborted after event `after`, until the feed is closed."""
        async for event in feed.follow(after):
            aborted = event.kind is EventKind.CAMPAIGN and event.data["state"] == CampaignState.ABORTED.value
            if aborted and event.campaign_id is not None:
                campaign = await asyncio.to_thread(self._store.campaign, event.campaign_id)
                if campaign.here:  # other machines may share the database
                    await self.settle(campaign.id)

    def _updated(self, campaign_id: int) -> EstimateDocument | None:
        """The latest revision, if it is an update of the one before it."""
        try:
            found = self._store.estimate(campaign_id)
        except NotFound:
            return None
        return found if found.document.get("updates") else None

    async def _fit_all(self, campaign_id: int) -> None:
        """Instead of the updates of the latest revision, which stays, and says so, if the fit fails."""
        updated = await asyncio.to_thread(self._updated, campaign_id)
        if updated is not None:
            job = await asyncio.to_thread(self._job, campaign_id, (), ())
            try:
                found = await self._worker.run_patiently(job)
            except (JobFailed, BadInput) as error:
                _log.error("fit_of_all_failed", campaign=campaign_id, cause=str(error))
            else:
                await asyncio.to_thread(self._store.replace_estimate, campaign_id, updated.revision, found.estimate)
        await self._complete(await asyncio.to_thread(self._store.campaign, campaign_id))

    async def _do(self, sweeps: Sequence[SweepDocument]) -> None:
        campaign_id = sweeps[0].campaign_id
        waiting = await asyncio.to_thread(self._still_recorded, sweeps)
        if waiting and not await self._identified(waiting):
            for sweep in waiting:
                with bound_contextvars(sweep=sweep.number):
                    await self._identified((sweep,))
        await self.settle(campaign_id)

    def _still_recorded(self, sweeps: Sequence[SweepDocument]) -> tuple[SweepDocument, ...]:
        """The sweeps that still wait for identification: after a repetition some of them are done."""

        def waits(sweep: SweepDocument) -> bool:
            found = self._store.sweep(sweep.campaign_id, sweep.number)
            return found.state is SweepState.RECORDED and found.attempt == sweep.attempt

        return tuple(filter(waits, sweeps))

    async def _identified(self, sweeps: Sequence[SweepDocument]) -> bool:
        """False, without effect, if the job of several sweeps failed. A single sweep becomes failed with its job."""
        last = sweeps[-1]
        try:
            with TRACING.span("identification", campaign=last.campaign_id, sweep=last.number):
                await self._identify(sweeps)
        except (JobFailed, BadInput) as error:
            cause = Cause(CauseCode.NOT_IDENTIFIED, last.spec.axis, detail=f"identification: {error}")
            log = _log.bind(campaign=last.campaign_id, cause=str(cause))
            if len(sweeps) > 1:
                log.warning("sweeps_identified_singly", first=sweeps[0].number, last=last.number)
                return False
            log.error("identification_failed", sweep=last.number)
            fail = sweep_move(SweepEvent.FAIL)
            await asyncio.to_thread(self._store.move_sweep, last.campaign_id, last.number, fail, cause)
        return True

    async def _identify(self, sweeps: Sequence[SweepDocument]) -> None:
        recordings = await asyncio.to_thread(
            lambda: [self._store.recording(sweep.campaign_id, sweep.number) for sweep in sweeps]
        )
        job = await asyncio.to_thread(self._job, sweeps[0].campaign_id, sweeps, recordings)
        result = await self._worker.run_patiently(job)
        paths = [recording.path for recording in recordings]
        spectra = await asyncio.to_thread(lambda: list(map(self._files.save_spectrum, paths, result.spectra)))
        identified, move = list(zip(sweeps, spectra, strict=True)), sweep_move(SweepEvent.IDENTIFY)
        with TRACING.span("store estimate"):
            estimate = await asyncio.to_thread(self._store.add_estimate, identified, move, result.estimate)
        if estimate is not None:
            _log.info("estimate", campaign=estimate.campaign_id, sweep=estimate.number, revision=estimate.revision)

    def _job(self, campaign_id: int, sweeps: Sequence[SweepDocument], recordings: Sequence[RecordingDocument]) -> Job:
        """Of some recorded sweeps with all identified ones, or of these alone."""
        new = tuple(
            RecordedSweep(sweep.spec, self._files.named(recording))
            for sweep, recording in zip(sweeps, recordings, strict=True)
        )
        campaign = self._store.campaign(campaign_id)
        robot = self._store.robot(campaign.robot_id)
        beside = campaign_beside(self._store, campaign)
        others = () if beside is None else self._store.spectra(beside.id)
        model = self._models.newest(campaign.robot_id)
        digest = hashlib.sha256("".join(recording.sha256 for recording in recordings).encode()).hexdigest()
        open_sweeps = sum(campaign.sweeps.get(state, 0) for state in FOLLOWS)
        return Job(
            key=f"identify-{digest}-{campaign.id}-{sweeps[-1].number if sweeps else 0}-{model.id if model else 0}",
            robot=robot.description,
            urdf_text=robot.urdf_text,
            sweeps=new,
            earlier=tuple(map(self._files.spectrum, (*others, *self._store.spectra(campaign.id)))),
            analyses=analysis_behind(self._store, beside or campaign),
            siblings=siblings_behind(self._store, beside or campaign),
            model=model,
            last=open_sweeps <= len(sweeps),
        )


def _digest(*content: object) -> str:
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()


def sweeps_a_revision(count: int) -> int:
    """Number of sweeps per revision in an imported campaign of `count` sweeps; the last revision may have fewer."""
    return -(-count // MOST_REVISIONS)


def open_groups(sweeps: Sequence[SweepDocument]) -> list[tuple[SweepDocument, ...]]:
    """The sweeps of an imported campaign that wait for identification, in the groups that share a revision."""
    size = sweeps_a_revision(len(sweeps))
    groups: dict[int, list[SweepDocument]] = {}
    for sweep in sweeps:
        if sweep.state is SweepState.RECORDED:
            groups.setdefault((sweep.number - 1) // size, []).append(sweep)
    return [tuple(group) for _, group in sorted(groups.items())]


class Checking(OpenJobs):
    """Submits campaigns to the worker and writes the findings."""

    def __init__(self, store: Store, checks: CheckStore, files: RecordingFiles, worker: Worker) -> None:
        super().__init__()
        self._store, self._checks, self._files, self._worker = store, checks, files, worker

    async def recover(self) -> None:
        """Submit the checks that the last process left open."""
        for campaign_id in await asyncio.to_thread(self._checks.wanting):
            self._submit(campaign_id)

    async def follow(self, feed: EventFeed, after: int) -> None:
        """Check each campaign that ends after event `after`, until the feed is closed."""
        ends = {state.value for state in OVER}
        async for event in feed.follow(after):
            if event.kind is EventKind.CAMPAIGN and event.campaign_id is not None and event.data["state"] in ends:
                self._submit(event.campaign_id)

    def _submit(self, campaign_id: int) -> None:
        self.begin(f"check of the data of campaign {campaign_id}", partial(self._do, campaign_id), campaign=campaign_id)

    async def _do(self, campaign_id: int) -> None:
        if campaign_id not in await asyncio.to_thread(self._checks.wanting, campaign_id):
            return
        try:
            job = await asyncio.to_thread(self._job, campaign_id)
            document = await self._worker.run_patiently(job)
        except (JobFailed, BadInput) as error:  # e.g. a file was changed; the identification reports it too
            _log.error("check_failed", campaign=campaign_id, cause=str(error))
            return
        await asyncio.to_thread(self._checks.add, campaign_id, document.as_json())

    def _job(self, campaign_id: int) -> CheckJob:
        robot = self._store.robot(self._store.campaign(campaign_id).robot_id)
        found = self._store.recorded_sweeps(campaign_id, COMPLETE)
        sweeps = tuple(RecordedSweep(spec, self._files.named(recording)) for spec, recording in found)
        digest = _digest(campaign_id, [recording.sha256 for _, recording in found])
        return CheckJob(f"check-{digest}", robot.description, robot.urdf_text, sweeps)


class Batches(OpenJobs):
    """Submits campaigns to the workers and writes the results."""

    def __init__(
        self, store: Store, batches: BatchStore, models: ModelStore, files: RecordingFiles, worker: Worker
    ) -> None:
        super().__init__()
        self._store, self._batches, self._models, self._files, self._worker = store, batches, models, files, worker

    async def recover(self) -> None:
        """Continue the batches that the last process left open."""
        for number in await asyncio.to_thread(self._batches.open):
            self._submit(number)

    async def request(self, campaigns: Sequence[int] | None, asked_by: str) -> BatchDocument:
        """Identify these campaigns again, or (None) all campaigns of this machine; returns immediately. BadInput."""
        batch = await asyncio.to_thread(self._batches.add, campaigns, asked_by)
        self._submit(batch.id)
        return batch

    async def request_payload(self, before: int, after: int, asked_by: str) -> PayloadDocument:
        """Identify the payload of campaign `after`; returns immediately. BadInput names the field."""
        payload = await asyncio.to_thread(self._batches.add_payload, before, after, asked_by)
        self._submit(payload.id)
        return payload

    async def cancel(self, batch_id: int) -> BatchDocument:
        """Cancel the rest of the batch; computed results are kept. No effect on a batch that is over."""
        await asyncio.to_thread(self._batches.batch, batch_id)
        batch = await asyncio.to_thread(self._batches.end, batch_id, BatchState.CANCELLED)
        self.end(f"job {batch_id}")
        return batch

    def _submit(self, batch_id: int) -> None:
        self.begin(f"job {batch_id}", partial(self._do, batch_id))

    async def _do(self, batch_id: int) -> None:
        campaigns = iter(await asyncio.to_thread(self._batches.begin, batch_id))
        try:
            workers = len(await self._worker.processes())
        except WorkerLost:
            workers = 1
        lanes = [
            asyncio.create_task(self._lane(batch_id, campaigns), name="lane of a job")
            for _ in range(2 * max(workers, 1))  # no worker waits for the next job
        ]
        try:
            await asyncio.gather(*lanes)
        finally:  # one lane failed, or the batch is cancelled
            for lane in lanes:
                lane.cancel()
            await asyncio.gather(*lanes, return_exceptions=True)
        await asyncio.to_thread(self._batches.end, batch_id, BatchState.DONE)
        _log.info("batch_done", batch=batch_id)

    async def _lane(self, batch_id: int, campaigns: Iterator[int]) -> None:
        """Process campaigns one after the other from the iterator that all lanes share."""
        for campaign_id in campaigns:
            try:
                job = await asyncio.to_thread(self._job, batch_id, campaign_id)
                found = await self._worker.run_patiently(job)
                result = found.sweeps, found.document, found.change_percent, ""
            except (JobFailed, BadInput, NotFound) as error:
                _log.warning("no_result_of_campaign", batch=batch_id, campaign=campaign_id, cause=str(error))
                result = 0, None, None, str(error)
            await asyncio.to_thread(self._batches.add_result, batch_id, campaign_id, *result)

    def _job(self, batch_id: int, campaign_id: int) -> ReidentifyJob | PayloadJob:
        """The job, with the input of the stored estimate and the present model of the robot; or that of a payload."""
        campaign = self._store.campaign(campaign_id)
        robot = self._store.robot(campaign.robot_id)
        empty = self._batches.before(batch_id)
        if empty is not None:
            pair = [self._store.recorded_sweeps(number, COMPLETE) for number in (empty, campaign_id)]
            digest = _digest([[recording.sha256 for _, recording in part] for part in pair])
            before, after = (
                tuple(RecordedSweep(spec, self._files.named(file)) for spec, file in part) for part in pair
            )
            return PayloadJob(f"payload-{digest}", robot.description, robot.urdf_text, before, after)
        beside = campaign_beside(self._store, campaign)
        numbers = (campaign_id,) if beside is None else (beside.id, campaign_id)
        found = [each for one in numbers for each in self._store.recorded_sweeps(one, {SweepState.IDENTIFIED})]
        model = self._models.newest(campaign.robot_id)
        hashes = [recording.sha256 for _, recording in found]
        digest = _digest(campaign_id, model.id if model else 0, hashes)
        return ReidentifyJob(
            key=f"reidentify-{digest}",
            robot=robot.description,
            urdf_text=robot.urdf_text,
            sweeps=tuple(RecordedSweep(spec, self._files.reference(recording)) for spec, recording in found),
            analyses=analysis_behind(self._store, beside or campaign),
            siblings=siblings_behind(self._store, beside or campaign),
            model=model,
            before=self._store.estimate(campaign_id).document,
        )
