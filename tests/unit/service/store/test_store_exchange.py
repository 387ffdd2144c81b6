"""Recording files, and campaigns in and out as bundles."""

from pathlib import Path

import numpy as np
import pytest

from service.model.errors import BadInput, Conflict
from service.model.recording import Recording, Sweep, SweepSpec
from service.model.robot import Robot
from service.store.documents import CampaignState, NewSweep, SweepState
from service.store.files.bundle import Bundle, save_bundle
from service.store.files.data_folder import campaign_bundle, import_campaign
from service.store.files.recordings import RecordingFiles
from service.store.store import Store

pytestmark = pytest.mark.slow


def recording(seed: int) -> Recording:
    noise = np.random.default_rng(seed).normal(size=(3, 50))
    return Recording(np.arange(50) / 1000.0, *noise)


@pytest.fixture
def files(tmp_path: Path) -> RecordingFiles:
    return RecordingFiles(tmp_path)


@pytest.fixture
def bundle(robot: Robot, specs: tuple[SweepSpec, ...]) -> Bundle:
    return Bundle(robot, tuple(Sweep(spec, recording(n)) for n, spec in enumerate(specs)))


def test_what_goes_in_comes_out(store: Store, files: RecordingFiles, bundle: Bundle) -> None:
    campaign = import_campaign(store, files, save_bundle(files, bundle))
    assert (campaign.state, campaign.plan_id) == (CampaignState.MEASURED, None)
    assert campaign.sweeps == {SweepState.RECORDED: 3}
    out = campaign_bundle(store, files, campaign.id)
    assert out.robot.description == bundle.robot.description
    for before, after in zip(bundle.sweeps, out.sweeps, strict=True):
        assert after.spec == before.spec
        np.testing.assert_array_equal(after.recording.effort, before.recording.effort)


def test_an_import_that_fails_leaves_nothing(
    store: Store, files: RecordingFiles, bundle: Bundle, tmp_path: Path
) -> None:
    short = Sweep(bundle.sweeps[2].spec, Recording(*np.zeros((4, 1))))
    with pytest.raises(BadInput, match="1 samples"):
        import_campaign(store, files, save_bundle(files, Bundle(bundle.robot, (*bundle.sweeps[:2], short))))
    assert store.campaigns() == ()
    assert list((tmp_path / "recordings").iterdir()) == []


def test_a_changed_or_missing_file_is_refused(store: Store, files: RecordingFiles, bundle: Bundle) -> None:
    campaign = import_campaign(store, files, save_bundle(files, bundle))
    document = store.recording(campaign.id, 1)
    path = files.path(document)
    content = path.read_bytes()
    path.write_bytes(content[:100] + bytes([content[100] ^ 1]) + content[101:])
    with pytest.raises(BadInput, match="was changed"):
        files.load(document)
    path.unlink()
    with pytest.raises(BadInput, match="is missing"):
        campaign_bundle(store, files, campaign.id)


def test_a_campaign_without_samples_is_no_bundle(
    store: Store, files: RecordingFiles, robot: Robot, specs: tuple[SweepSpec, ...]
) -> None:
    plan = store.add_plan(store.add_robot(robot).id, {})
    campaign = store.add_campaign(plan.id, [NewSweep(spec=specs[0], mode=None)])
    with pytest.raises(Conflict, match="no complete recording"):
        campaign_bundle(store, files, campaign.id)
