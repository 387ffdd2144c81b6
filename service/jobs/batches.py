"""Repeats the identification of stored campaigns, on all available workers, with progress and cancellation.

The store is the outbox, as in `service.jobs.jobs`: campaigns of an open batch without a result are processed after a
restart. Stored estimates are not changed: a batch has its own results. Its jobs have the lowest priority.
"""

import asyncio
import hashlib
import json
from collections.abc import Iterator, Sequence
from functools import partial

import structlog

from service.jobs.open_jobs import OpenJobs
from service.jobs.worker import JobFailed, RecordedSweep, ReidentifyJob, Worker, WorkerLost
from service.model.errors import BadInput, NotFound
from service.planning.campaigns.linked import analysis_behind, campaign_beside
from service.store.diagnoses import ModelStore
from service.store.documents import BatchState, SweepState
from service.store.files.recordings import RecordingFiles
from service.store.plant import BatchDocument, BatchStore
from service.store.store import Store

_log = structlog.get_logger(__name__)

_AHEAD = 2  # jobs submitted per worker, so that no worker waits for the next job
_UNKNOWN = 1  # assumed number of workers while none answers


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

    async def cancel(self, batch_id: int) -> BatchDocument:
        """Cancel the rest of the batch; computed results are kept. No effect on a batch that is over."""
        batch = await asyncio.to_thread(self._batches.end, batch_id, BatchState.CANCELLED)
        self.end(f"re-identification {batch_id}")
        return batch

    def _submit(self, batch_id: int) -> None:
        self.begin(f"re-identification {batch_id}", partial(self._do, batch_id))

    async def _do(self, batch_id: int) -> None:
        campaigns = iter(await asyncio.to_thread(self._batches.begin, batch_id))
        try:
            workers = len(await self._worker.processes())
        except WorkerLost:
            workers = _UNKNOWN
        lanes = [
            asyncio.create_task(self._lane(batch_id, campaigns), name="lane of a re-identification")
            for _ in range(_AHEAD * max(workers, 1))
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
                job = await asyncio.to_thread(self._job, campaign_id)
                found = await self._worker.run_patiently(job)
            except (JobFailed, BadInput, NotFound) as error:
                _log.warning("not_identified_again", batch=batch_id, campaign=campaign_id, cause=str(error))
                write = partial(self._batches.add_result, batch_id, campaign_id, 0, None, cause=str(error))
            else:
                result = found.sweeps, found.estimate, found.change_percent
                write = partial(self._batches.add_result, batch_id, campaign_id, *result)
            await asyncio.to_thread(write)

    def _job(self, campaign_id: int) -> ReidentifyJob:
        """The job, with the input of the stored estimate and the present model of the robot."""
        campaign = self._store.campaign(campaign_id)
        robot = self._store.robot(campaign.robot_id)
        beside = campaign_beside(self._store, campaign)
        sweeps: list[RecordedSweep] = []
        hashes: list[str] = []
        for number in (campaign_id,) if beside is None else (beside.id, campaign_id):
            recordings = self._store.recordings(number)
            for sweep in self._store.sweeps(number):
                if sweep.state is SweepState.IDENTIFIED:
                    recording = recordings[sweep.number]
                    sweeps.append(RecordedSweep(sweep.spec, self._files.reference(recording)))
                    hashes.append(recording.sha256)
        model = self._models.newest(campaign.robot_id)
        digest = hashlib.sha256(json.dumps([campaign_id, model.id if model else 0, hashes]).encode()).hexdigest()
        return ReidentifyJob(
            key=f"reidentify-{digest}",
            robot=robot.description,
            urdf_text=robot.urdf_text,
            sweeps=tuple(sweeps),
            analyses=analysis_behind(self._store, beside or campaign),
            model=model,
            before=self._store.estimate(campaign_id).document,
        )
