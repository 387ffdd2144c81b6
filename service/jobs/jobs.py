"""Open identification jobs: from the recorded sweep's row to the estimate revision.

The store is the outbox: a job is open while its sweep is `recorded`; open jobs are found again after a restart.
The jobs of a campaign run in the order of recording, one after the other, so that every revision contains the one
before it. The identification of a sweep uses the effects of the robot's newest accepted model.

Each sweep of a campaign that was measured here has its own revision. In a large imported campaign several sweeps
share a revision (`open_groups`): the estimate after the first 17 of 900 sweeps is of no use. Which sweeps have one
depends only on the number of sweeps, so it is the same after a restart. One job computes the spectra of a group and one
estimate, and one transaction stores all of it. If that job fails, its sweeps are identified one after the other, so
that only the sweeps with a fault fail.
"""

import asyncio
import hashlib
from collections import defaultdict
from collections.abc import Sequence
from functools import partial

import structlog
from structlog.contextvars import bound_contextvars

from drivers.errors import Cause, CauseCode
from service.jobs.open_jobs import OpenJobs
from service.jobs.worker import Job, JobFailed, RecordedSweep, Result, Worker
from service.model.errors import BadInput
from service.planning.campaigns.linked import analysis_behind, campaign_beside
from service.planning.campaigns.state_machine import CampaignEvent, SweepEvent, campaign_move, sweep_move
from service.process.telemetry.spans import TRACING
from service.store.diagnoses import ModelStore
from service.store.documents import CampaignState, RecordingDocument, SpectrumRecord, SweepDocument, SweepState
from service.store.files.recordings import RecordingFiles
from service.store.store import Store

_log = structlog.get_logger(__name__)

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
        """measured -> completed, if no sweep is left to identify."""
        campaign = await asyncio.to_thread(self._store.campaign, campaign_id)
        if campaign.state is CampaignState.MEASURED and SweepState.RECORDED not in campaign.sweeps:
            identified = campaign_move(CampaignEvent.IDENTIFIED)
            cause = campaign.structured_cause
            await asyncio.to_thread(self._store.move_campaign, campaign_id, identified, cause)

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
        now = [self._store.sweep(sweep.campaign_id, sweep.number) for sweep in sweeps]
        return tuple(
            sweep
            for sweep, found in zip(sweeps, now, strict=True)
            if found.state is SweepState.RECORDED and found.attempt == sweep.attempt
        )

    async def _identified(self, sweeps: Sequence[SweepDocument]) -> bool:
        """False, without effect, if the job of several sweeps failed. A single sweep becomes failed with its job."""
        first, last = sweeps[0], sweeps[-1]
        try:
            with TRACING.span("identification", campaign=last.campaign_id, sweep=last.number):
                await self._identify(sweeps)
        except (JobFailed, BadInput) as error:
            cause = Cause(CauseCode.NOT_IDENTIFIED, last.spec.axis, detail=f"identification: {error}")
            if len(sweeps) > 1:
                _log.warning(
                    "sweeps_identified_singly",
                    campaign=last.campaign_id,
                    first=first.number,
                    last=last.number,
                    cause=str(cause),
                )
                return False
            _log.error("identification_failed", campaign=last.campaign_id, sweep=last.number, cause=str(cause))
            await asyncio.to_thread(
                self._store.move_sweep, last.campaign_id, last.number, sweep_move(SweepEvent.FAIL), cause
            )
        return True

    async def _identify(self, sweeps: Sequence[SweepDocument]) -> None:
        recordings = await asyncio.to_thread(self._recordings, sweeps)
        result = await self._worker.run_patiently(await asyncio.to_thread(self._job, sweeps, recordings))
        spectra = await asyncio.to_thread(self._save, recordings, result)
        with TRACING.span("store estimate"):
            estimate = await asyncio.to_thread(
                self._store.add_estimate,
                list(zip(sweeps, spectra, strict=True)),
                sweep_move(SweepEvent.IDENTIFY),
                result.estimate,
            )
        if estimate is not None:
            _log.info("estimate", campaign=estimate.campaign_id, sweep=estimate.number, revision=estimate.revision)

    def _recordings(self, sweeps: Sequence[SweepDocument]) -> list[RecordingDocument]:
        return [self._store.recording(sweep.campaign_id, sweep.number) for sweep in sweeps]

    def _save(self, recordings: Sequence[RecordingDocument], result: Result) -> list[SpectrumRecord]:
        found = zip(recordings, result.spectra, strict=True)
        return [self._files.save_spectrum(recording.path, spectrum) for recording, spectrum in found]

    def _job(self, sweeps: Sequence[SweepDocument], recordings: Sequence[RecordingDocument]) -> Job:
        new = tuple(
            RecordedSweep(sweep.spec, self._files.named(recording))
            for sweep, recording in zip(sweeps, recordings, strict=True)
        )
        campaign = self._store.campaign(sweeps[0].campaign_id)
        robot = self._store.robot(campaign.robot_id)
        beside = campaign_beside(self._store, campaign)
        others = () if beside is None else self._store.spectra(beside.id)
        model = self._models.newest(campaign.robot_id)
        digest = hashlib.sha256("".join(recording.sha256 for recording in recordings).encode()).hexdigest()
        return Job(
            key=f"identify-{digest}-{campaign.id}-{sweeps[-1].number}-{model.id if model else 0}",
            robot=robot.description,
            urdf_text=robot.urdf_text,
            sweeps=new,
            earlier=tuple(map(self._files.spectrum, (*others, *self._store.spectra(campaign.id)))),
            analyses=analysis_behind(self._store, beside or campaign),
            model=model,
        )


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
