"""The check of the data of every campaign that is over: one job a campaign, in the worker.

The store is the outbox, as in `service.campaigns.jobs`: what is over and not checked is found again after a restart.
"""

import asyncio
import hashlib
import json

import structlog

from service.campaigns.live import EventFeed
from service.errors import BadInput
from service.store.checks import COMPLETE, OVER, CheckStore
from service.store.documents import EventKind
from service.store.recordings import RecordingFiles
from service.store.store import Store
from service.worker import CheckJob, JobFailed, RecordedSweep, Worker, WorkerLost

_log = structlog.get_logger(__name__)

_RETRY = 2.0  # s between attempts to reach the workers
_ENDS = {state.value for state in OVER}


class Checking:
    """Hands campaigns to the worker and writes what it finds."""

    def __init__(self, store: Store, checks: CheckStore, files: RecordingFiles, worker: Worker) -> None:
        self._store, self._checks, self._files, self._worker = store, checks, files, worker
        self._tasks: dict[int, asyncio.Task[None]] = {}

    async def recover(self) -> None:
        """Submit what the last process left open."""
        for campaign_id in await asyncio.to_thread(self._checks.wanting):
            self._submit(campaign_id)

    async def follow(self, feed: EventFeed, after: int) -> None:
        """Check what ends from event `after` on, until the feed is closed."""
        async for event in feed.follow(after):
            if event.kind is EventKind.CAMPAIGN and event.campaign_id is not None and event.data["state"] in _ENDS:
                self._submit(event.campaign_id)

    async def close(self) -> None:
        """Leave open checks to the next process."""
        tasks = list(self._tasks.values())
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    def _submit(self, campaign_id: int) -> None:
        if campaign_id in self._tasks:
            return
        task = asyncio.create_task(self._do(campaign_id), name=f"check {campaign_id}")
        self._tasks[campaign_id] = task
        task.add_done_callback(lambda done: self._done(campaign_id, done))

    async def _do(self, campaign_id: int) -> None:
        if campaign_id not in await asyncio.to_thread(self._checks.wanting, campaign_id):
            return
        try:
            job = await asyncio.to_thread(self._job, campaign_id)
            while True:
                try:
                    document = await self._worker.run(job)
                    break
                except WorkerLost as error:
                    _log.warning("worker_lost", reason=str(error))
                    await asyncio.sleep(_RETRY)
        except (JobFailed, BadInput) as error:  # a file that was changed; the identification says so, too
            _log.error("check_failed", campaign=campaign_id, cause=str(error))
            return
        await asyncio.to_thread(self._checks.add, campaign_id, document)

    def _job(self, campaign_id: int) -> CheckJob:
        robot = self._store.robot(self._store.campaign(campaign_id).robot_id)
        sweeps: list[RecordedSweep] = []
        told: list[str] = []
        for sweep in self._store.sweeps(campaign_id):
            if sweep.state in COMPLETE:
                recording = self._store.recording(campaign_id, sweep.number)
                self._files.check(recording)
                sweeps.append(RecordedSweep(sweep.spec, self._files.path(recording).absolute()))
                told.append(recording.sha256)
        digest = hashlib.sha256(json.dumps([campaign_id, told]).encode()).hexdigest()
        return CheckJob(f"check-{digest}", robot.description, robot.urdf_text, tuple(sweeps))

    def _done(self, campaign_id: int, task: asyncio.Task[None]) -> None:
        del self._tasks[campaign_id]
        if not task.cancelled() and (error := task.exception()) is not None:
            # nothing was written: the next start submits it again
            _log.error("check_broke_off", task=task.get_name(), error=repr(error))
