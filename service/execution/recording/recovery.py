"""What did not come to its end: sweeps are interrupted, campaigns paused, torn streams become partial recordings.

After a restart, and where the database refused it when it was due. Nothing moves by any of it.
"""

from pathlib import Path

import structlog

from service.campaigns.session import CampaignEvent, SweepEvent, campaign_move, sweep_move
from service.errors import BadInput, NotFound
from service.execution.recording.recorder import salvage
from service.results.identified.manifest import Facts
from service.store.documents import CampaignState, SweepState
from service.store.files.recordings import RecordingFiles, Run
from service.store.files.stream import UnreadableStream
from service.store.store import Store

_log = structlog.get_logger(__name__)

_CAUSE = "the service ended during the sweep"


def recover(store: Store, files: RecordingFiles) -> tuple[int, ...]:
    """Bring store and files in order before anything is started. To be called with the machine's lease held.

    The campaigns that the last process left running.
    """
    left = end_runs(store, files, _CAUSE, "the service was restarted")
    while store.move_spectrum_to_file(files.save_spectrum):
        pass
    for run, path in files.streams().items():
        if not _known(store, run):
            # of a campaign, sweep or attempt that a database brought back from a backup has forgotten
            _log.error("unknown_stream", path=str(files.put_aside(path, "unknown")))
            continue
        _bring_in(store, files, run, path)
    return left


def end_runs(store: Store, files: RecordingFiles, sweep_cause: str, campaign_cause: str) -> tuple[int, ...]:
    """Store that nothing runs: to be called while nothing does. The campaigns that ran."""
    for sweep in store.sweeps_in(SweepState.RUNNING):
        run = Run(sweep.campaign_id, sweep.number, sweep.attempt)
        break_off(store, files, run, SweepEvent.INTERRUPT, sweep_cause, _facts(run))
        _log.warning("recovered", campaign=run.campaign_id, sweep=run.number)
    ran = store.campaigns_in(CampaignState.RUNNING, CampaignState.PAUSING)
    for campaign in ran:
        store.move_campaign(campaign.id, campaign_move(CampaignEvent.TROUBLE), campaign_cause)
        _log.info("campaign", campaign=campaign.id, happened=CampaignEvent.TROUBLE.value, cause=campaign_cause)
    return tuple(campaign.id for campaign in ran)


def break_off(store: Store, files: RecordingFiles, run: Run, event: SweepEvent, cause: str, facts: Facts) -> None:
    """End a run that did not come to its end; what came of its samples is kept as a partial recording."""
    try:
        recording = salvage(files, run, {**facts, "cause": cause})
    except (OSError, UnreadableStream, BadInput) as error:  # the stream stays; the next start looks at it again
        cause, recording = f"{cause}; partial recording not written: {error}", None
    store.end_sweep(run.campaign_id, run.number, sweep_move(event), cause, None, recording)
    if recording is not None:
        files.stream(run).unlink()


def _bring_in(store: Store, files: RecordingFiles, run: Run, path: Path) -> None:
    """Make a recording of a stream that lies about, if its run has none; the stream goes, a damaged one aside."""
    if not _has_recording(store, run):
        try:
            recording = salvage(files, run, {**_facts(run), "cause": _CAUSE})
        except (UnreadableStream, BadInput) as error:
            aside = files.put_aside(path, "unreadable")
            _log.error("unreadable_stream", path=str(aside), reason=str(error))
            return
        except OSError as error:  # a full disk, say: the stream stays, and the next start looks at it again
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
