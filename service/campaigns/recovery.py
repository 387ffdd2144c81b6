"""After a restart: nothing moves, what was running is marked interrupted, torn streams become partial recordings."""

import structlog

from service.campaigns.recorder import salvage
from service.campaigns.session import CampaignEvent, SweepEvent, campaign_move, sweep_move
from service.errors import NotFound
from service.store.documents import CampaignState, NewRecording, SweepState
from service.store.recordings import RecordingFiles, Run
from service.store.store import Store

_log = structlog.get_logger(__name__)

_CAUSE = "the service ended during the sweep"


def recover(store: Store, files: RecordingFiles) -> None:
    """Bring store and files in order before anything is started. To be called with the machine's lease held."""
    for sweep in store.sweeps_in(SweepState.RUNNING):
        run = Run(sweep.campaign_id, sweep.number, sweep.attempt)
        recording = _salvage(files, run)
        store.end_sweep(run.campaign_id, run.number, sweep_move(SweepEvent.INTERRUPT), _CAUSE, None, recording)
        _log.warning("recovered", campaign=run.campaign_id, sweep=run.number, samples=recording and recording.samples)
    for campaign in store.campaigns_in(CampaignState.RUNNING, CampaignState.PAUSING):
        store.move_campaign(campaign.id, campaign_move(CampaignEvent.TROUBLE), "the service was restarted")
    for run, path in files.streams().items():
        try:
            store.sweep(run.campaign_id, run.number)
        except NotFound:
            _log.warning("unknown_stream", path=str(path))
            continue
        if not _has_recording(store, run):
            recording = _salvage(files, run)
            if recording is not None:
                store.add_recording(run.campaign_id, run.number, run.attempt, recording)
        path.unlink()


def _salvage(files: RecordingFiles, run: Run) -> NewRecording | None:
    return salvage(files, run, {"campaign": run.campaign_id, "sweep": run.number, "cause": _CAUSE})


def _has_recording(store: Store, run: Run) -> bool:
    try:
        return store.recording(run.campaign_id, run.number).attempt >= run.attempt
    except NotFound:
        return False
