"""Whole campaigns in and out as bundles."""

import shutil
from uuid import uuid4

from service.errors import Conflict
from service.recording import Sweep
from service.store.bundle import Bundle
from service.store.documents import CampaignDocument, NewSweep, RecordingState, SweepState
from service.store.recordings import RecordingFiles
from service.store.store import Store


def import_campaign(store: Store, files: RecordingFiles, bundle: Bundle) -> CampaignDocument:
    """A measured campaign of a bundle's sweeps, which wait to be identified; all of it or nothing is stored."""
    folder = files.folder(f"import-{uuid4().hex}")
    try:
        recordings = [
            files.save(
                folder / f"{number:04d}-1.parquet",
                sweep.recording,
                RecordingState.COMPLETE,
                {"robot": bundle.robot.name, "spec": sweep.spec.model_dump(mode="json")},
            )
            for number, sweep in enumerate(bundle.sweeps, 1)
        ]
        robot = store.add_robot(bundle.robot)
        sweeps = [NewSweep(spec=sweep.spec, mode=None) for sweep in bundle.sweeps]
        return store.add_measured(robot.id, sweeps, recordings)
    except BaseException:
        shutil.rmtree(folder)
        raise


def campaign_bundle(store: Store, files: RecordingFiles, campaign_id: int) -> Bundle:
    """The complete sweeps of a campaign, as the estimate knows them; Conflict if there is none yet."""
    robot = store.robot(store.campaign(campaign_id).robot_id).build()
    sweeps = tuple(
        Sweep(sweep.spec, files.load(store.recording(campaign_id, sweep.number)))
        for sweep in store.sweeps(campaign_id)
        if sweep.state in (SweepState.RECORDED, SweepState.IDENTIFIED)
    )
    if not sweeps:
        raise Conflict(f"campaign {campaign_id} has no complete recording yet")
    return Bundle(robot, sweeps)
