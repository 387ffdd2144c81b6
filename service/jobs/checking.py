"""The data check of every finished campaign: one job per campaign, in the worker.

The store is the outbox, as in `service.jobs.jobs`: finished campaigns without check are found again after a restart.
"""

import asyncio
import hashlib
import json
from functools import partial

import structlog

from service.jobs.open_jobs import OpenJobs
from service.jobs.worker import CheckJob, JobFailed, RecordedSweep, Worker
from service.model.errors import BadInput
from service.planning.campaigns.live import EventFeed
from service.store.documents import EventKind
from service.store.files.recordings import RecordingFiles
from service.store.store import COMPLETE, OVER, CheckStore, Store

_log = structlog.get_logger(__name__)

_ENDS = {state.value for state in OVER}


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
        async for event in feed.follow(after):
            if event.kind is EventKind.CAMPAIGN and event.campaign_id is not None and event.data["state"] in _ENDS:
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
        await asyncio.to_thread(self._checks.add, campaign_id, document)

    def _job(self, campaign_id: int) -> CheckJob:
        robot = self._store.robot(self._store.campaign(campaign_id).robot_id)
        sweeps: list[RecordedSweep] = []
        hashes: list[str] = []
        for sweep in self._store.sweeps(campaign_id):
            if sweep.state in COMPLETE:
                recording = self._store.recording(campaign_id, sweep.number)
                sweeps.append(RecordedSweep(sweep.spec, self._files.named(recording)))
                hashes.append(recording.sha256)
        digest = hashlib.sha256(json.dumps([campaign_id, hashes]).encode()).hexdigest()
        return CheckJob(f"check-{digest}", robot.description, robot.urdf_text, tuple(sweeps))
