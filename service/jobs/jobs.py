"""Open identification jobs: from the recorded sweep's row to the estimate revision.

The store is the outbox: a job is open while its sweep is `recorded`, and what is open is found again after a restart.
The jobs of a campaign run in the order of recording, one after the other, so that every revision contains the one
before it. A sweep is identified with what the robot's newest accepted model says of its effects.
"""

import asyncio
from collections import defaultdict
from functools import partial

import structlog

from service.campaigns.linked_analysis import analysis_behind
from service.campaigns.linked_campaign import campaign_beside
from service.campaigns.session import CampaignEvent, SweepEvent, campaign_move, sweep_move
from service.errors import BadInput
from service.jobs.open_jobs import OpenJobs
from service.store.diagnosis.model_revisions import ModelStore
from service.store.documents import CampaignState, RecordingDocument, SweepDocument, SweepState
from service.store.files.recordings import RecordingFiles
from service.store.store import Store
from service.worker import Job, JobFailed, Worker

_log = structlog.get_logger(__name__)


class Jobs:
    """Hands recorded sweeps to the worker and writes its results."""

    def __init__(self, store: Store, files: RecordingFiles, worker: Worker, models: ModelStore) -> None:
        self._store, self._files, self._worker, self._models = store, files, worker, models
        self._turn: defaultdict[int, asyncio.Lock] = defaultdict(asyncio.Lock)  # by campaign, first come first served
        self._open = OpenJobs()

    @property
    def open(self) -> int:
        """How many sweeps wait to be identified."""
        return len(self._open)

    @property
    def troubles(self) -> tuple[str, ...]:
        return self._open.troubles

    async def recover(self) -> None:
        """Submit what the last process left open."""
        for campaign in await asyncio.to_thread(self._store.campaigns_in, CampaignState.MEASURED):
            await self.settle(campaign.id)
        for sweep in await asyncio.to_thread(self._store.sweeps_in, SweepState.RECORDED):
            self.submit(sweep)

    def submit(self, sweep: SweepDocument) -> None:
        """Identify a recorded sweep; returns at once."""
        name = f"identification of campaign {sweep.campaign_id} sweep {sweep.number} attempt {sweep.attempt}"
        self._open.begin(name, partial(self._do, sweep), self._turn[sweep.campaign_id])

    async def settle(self, campaign_id: int) -> None:
        """measured -> completed, if no sweep is left to identify."""
        campaign = await asyncio.to_thread(self._store.campaign, campaign_id)
        if campaign.state is CampaignState.MEASURED and SweepState.RECORDED not in campaign.sweeps:
            identified = campaign_move(CampaignEvent.IDENTIFIED)
            await asyncio.to_thread(self._store.move_campaign, campaign_id, identified, campaign.cause)

    async def close(self) -> None:
        """Leave open jobs to the next process."""
        await self._open.close()

    async def _do(self, sweep: SweepDocument) -> None:
        try:
            await self._identify(sweep)
        except (JobFailed, BadInput) as error:
            cause = f"identification: {error}"
            _log.error("identification_failed", campaign=sweep.campaign_id, sweep=sweep.number, cause=cause)
            await asyncio.to_thread(
                self._store.move_sweep, sweep.campaign_id, sweep.number, sweep_move(SweepEvent.FAIL), cause
            )
        await self.settle(sweep.campaign_id)

    async def _identify(self, sweep: SweepDocument) -> None:
        recording = await asyncio.to_thread(self._store.recording, sweep.campaign_id, sweep.number)
        job = await asyncio.to_thread(self._job, sweep, recording)
        result = await self._worker.run_patiently(job)
        spectrum = await asyncio.to_thread(self._files.save_spectrum, recording.path, result.spectrum)
        estimate = await asyncio.to_thread(
            self._store.add_estimate, sweep, sweep_move(SweepEvent.IDENTIFY), spectrum, result.estimate
        )
        if estimate is not None:
            _log.info("estimate", campaign=sweep.campaign_id, sweep=sweep.number, revision=estimate.revision)

    def _job(self, sweep: SweepDocument, recording: RecordingDocument) -> Job:
        self._files.check(recording)
        campaign = self._store.campaign(sweep.campaign_id)
        robot = self._store.robot(campaign.robot_id)
        beside = campaign_beside(self._store, campaign)
        others = () if beside is None else self._store.spectra(beside.id)
        model = self._models.newest(campaign.robot_id)
        return Job(
            key=f"identify-{recording.sha256}-{sweep.campaign_id}-{sweep.number}-{model.id if model else 0}",
            robot=robot.description,
            urdf_text=robot.urdf_text,
            spec=sweep.spec,
            path=self._files.path(recording).absolute(),
            earlier=tuple(map(self._files.spectrum, (*others, *self._store.spectra(sweep.campaign_id)))),
            analyses=analysis_behind(self._store, beside or campaign),
            model=model,
        )
