"""Imports and exports whole campaigns as bundles."""

from service.model.errors import Conflict
from service.model.recording import Sweep
from service.model.robot import build_robot
from service.store.documents import CampaignDocument, NewSweep, SweepState
from service.store.files.bundle import Bundle
from service.store.files.intake import SavedBundle
from service.store.files.recordings import RecordingFiles
from service.store.store import Store


def import_campaign(store: Store, files: RecordingFiles, saved: SavedBundle) -> CampaignDocument:
    """A measured campaign of sweeps whose recordings are in `files`, and which wait for identification.

    If it cannot be stored, the recordings are removed.
    """
    try:
        robot = store.add_robot(build_robot(saved.robot, saved.urdf_text))
        return store.add_measured(robot.id, [NewSweep(spec=spec, mode=None) for spec in saved.sweeps], saved.recordings)
    except BaseException:
        files.remove_folder(saved.folder)
        raise


def campaign_bundle(store: Store, files: RecordingFiles, campaign_id: int) -> Bundle:
    """The complete sweeps of a campaign, as used by the estimate. Raises Conflict if there is none yet."""
    robot = store.robot(store.campaign(campaign_id).robot_id).build()
    sweeps = tuple(
        Sweep(sweep.spec, files.load(store.recording(campaign_id, sweep.number)))
        for sweep in store.sweeps(campaign_id)
        if sweep.state in (SweepState.RECORDED, SweepState.IDENTIFIED)
    )
    if not sweeps:
        raise Conflict(f"campaign {campaign_id} has no complete recording yet")
    return Bundle(robot, sweeps)
