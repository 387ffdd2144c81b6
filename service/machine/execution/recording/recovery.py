"""Recovery of unfinished work: sweeps are interrupted, campaigns paused, incomplete streams become partial recordings.

Used after a restart, and when the database refused the data at the end of a sweep. It moves nothing.
"""

from dataclasses import replace
from pathlib import Path

import structlog
from structlog.contextvars import bound_contextvars

from drivers.errors import Cause, CauseCode
from service.machine.execution.recording.recorder import salvage
from service.model.errors import BadInput, NotFound
from service.model.results.identified.manifest import Facts
from service.planning.campaigns.state_machine import CampaignEvent, SweepEvent, campaign_move, sweep_move
from service.store.documents import CampaignState, SweepState
from service.store.files.columns import UnreadableStream
from service.store.files.recordings import RecordingFiles, Run
from service.store.store import Store

_log = structlog.get_logger(__name__)

_CAUSE = Cause(CauseCode.SERVICE_ENDED, detail="the service ended during the sweep")
_RESTARTED = Cause(CauseCode.SERVICE_ENDED, detail="the service was restarted")


def recover(store: Store, files: RecordingFiles) -> tuple[int, ...]:
    """Make store and files consistent before anything is started. Call it while holding the machine's lease.

    Returns the campaigns that the last process left running.
    """
    left = end_runs(store, files, _CAUSE, _RESTARTED)
    store_streams(store, files, str(_CAUSE))
    return left


def store_streams(store: Store, files: RecordingFiles, cause: str) -> None:
    """Make partial recordings of the streams of ended sweeps. Call it while nothing runs.

    `cause`: why they were not stored when their sweeps ended. A stream that cannot be stored now stays.
    """
    for run, path in files.streams().items():
        with bound_contextvars(campaign=run.campaign_id, sweep=run.number):
            _look_at(store, files, run, path, cause)


def _look_at(store: Store, files: RecordingFiles, run: Run, path: Path, cause: str) -> None:
    """Process one remaining stream."""
    if not _known(store, run):
        # of a campaign, sweep or attempt that is missing in a database restored from a backup
        _log.error("unknown_stream", path=str(files.put_aside(path, "unknown")))
        return
    _store_stream(store, files, run, path, cause)


def end_runs(store: Store, files: RecordingFiles, sweep_cause: Cause, campaign_cause: Cause) -> tuple[int, ...]:
    """Store that nothing runs; call it while nothing does. Returns the campaigns that ran."""
    for sweep in store.sweeps_in(SweepState.RUNNING):
        run = Run(sweep.campaign_id, sweep.number, sweep.attempt)
        break_off(store, files, run, SweepEvent.INTERRUPT, sweep_cause, _facts(run))
        _log.warning("recovered", campaign=run.campaign_id, sweep=run.number)
    ran = store.campaigns_in(CampaignState.RUNNING, CampaignState.PAUSING)
    for campaign in ran:
        store.move_campaign(campaign.id, campaign_move(CampaignEvent.TROUBLE), campaign_cause)
        _log.info("campaign", campaign=campaign.id, happened=CampaignEvent.TROUBLE.value, cause=str(campaign_cause))
    return tuple(campaign.id for campaign in ran)


def break_off(store: Store, files: RecordingFiles, run: Run, event: SweepEvent, cause: Cause, facts: Facts) -> None:
    """End an unfinished run; its samples are kept as a partial recording."""
    try:
        recording = salvage(files, run, {**facts, "cause": str(cause)})
    except (OSError, UnreadableStream, BadInput) as error:  # the stream stays until the next start or resume
        cause = replace(cause, detail=f"{cause.detail}; partial recording not written: {error}")
        recording = None
    store.end_sweep(run.campaign_id, run.number, sweep_move(event), cause, None, recording)
    if recording is not None:
        files.stream(run).unlink()


def _store_stream(store: Store, files: RecordingFiles, run: Run, path: Path, cause: str) -> None:
    """Make a recording of a remaining stream if its run has none. The stream is removed, a damaged one renamed."""
    if not _has_recording(store, run):
        try:
            recording = salvage(files, run, {**_facts(run), "cause": cause})
        except (UnreadableStream, BadInput) as error:
            aside = files.put_aside(path, "unreadable")
            _log.error("unreadable_stream", path=str(aside), reason=str(error))
            return
        except OSError as error:  # e.g. a full disk: the stream stays until the next start or resume
            _log.error("stream_left", path=str(path), reason=str(error))
            return
        if recording is not None:
            store.add_recording(run.campaign_id, run.number, run.attempt, recording)
    path.unlink()


def _facts(run: Run) -> Facts:
    return {"campaign": run.campaign_id, "sweep": run.number}


def _known(store: Store, run: Run) -> bool:
    try:
        return run.attempt <= store.sweep(run.campaign_id, run.number).attempt
    except NotFound:
        return False


def _has_recording(store: Store, run: Run) -> bool:
    try:
        return store.recording(run.campaign_id, run.number).attempt >= run.attempt
    except NotFound:
        return False
