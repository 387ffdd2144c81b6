"""`sweepid estimate channels` as a person calls it: YAML for the drive profile or JSON, exit code 2 for bad input."""

import json
import math
from pathlib import Path

import pytest
import yaml

from service.cli.recordings.channels import as_document, profile_lines
from service.identification.axis.channel_timing import ChannelLags, Lag
from service.identification.spectra.axis_inertia import DriveTrain
from service.store.files.bundle import write_bundle
from tests.command import sweepid
from tests.numeric.campaign import max100
from tests.numeric.test_channel_timing import CALIBRATION, lagging, swept


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    robot = max100()
    path = tmp_path_factory.mktemp("calibration") / "bundle"
    write_bundle(path, robot, swept(lagging("effort"), robot, "joint_1", CALIBRATION, poses=2, seed=5))
    return path


def test_the_lines_for_the_profile_and_the_document_say_the_same(bundle: Path, tmp_path: Path) -> None:
    target = tmp_path / "channels.json"
    done = sweepid("estimate", "channels", str(bundle), "--axis", "joint_1", "--json", str(target))
    assert (done.returncode, done.stderr) == (0, "")
    effort = json.loads(target.read_text())["axes"]["joint_1"]["effort"]
    assert effort["apart"] is True
    for name, truth in (("delay", 1e-3), ("smoothing", 2e-3), ("total", 3e-3)):
        assert abs(effort[name]["value"] - truth) < 3 * effort[name]["std"]
    channels = yaml.safe_load(done.stdout)["channels"]
    assert channels["effort_delay"] == pytest.approx(effort["delay"]["value"], abs=1e-7)
    assert channels["effort_smoothing"] == pytest.approx(effort["smoothing"]["value"], abs=1e-7)
    assert set(channels) == {"effort_delay", "effort_smoothing", "velocity_delay", "velocity_smoothing"}


def test_json_is_all_there_is_on_stdout(bundle: Path) -> None:
    done = sweepid("estimate", "channels", str(bundle), "--json", "-")
    assert list(json.loads(done.stdout)["axes"]) == ["joint_1"]


def test_an_axis_without_sweeps_is_bad_input(bundle: Path) -> None:
    done = sweepid("estimate", "channels", str(bundle), "--axis", "joint_2")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == f"sweepid: {bundle}: has no sweep with sines of joint joint_2\n"


def test_what_cannot_be_told_apart_is_said() -> None:
    lag = Lag(5e-4, 1e-5, 0.0, 2e-4, 5e-4, 1e-5, apart=False)
    text = profile_lines("joint_1", ChannelLags(lag, lag, DriveTrain(58.0, 140.0, 60.0, 1e-6, 1e-3), 21.3))
    assert "effort_delay: 0.0005000 # s, +- 1e-05, delay and smoothing together: they cannot be separated" in text
    assert yaml.safe_load(text)["channels"]["effort_smoothing"] == 0.0


def test_a_stiff_train_has_no_free_resonance() -> None:
    lag = Lag(5e-4, 1e-5, 0.0, 2e-4, 5e-4, 1e-5, apart=False)
    lags = ChannelLags(lag, lag, DriveTrain(58.0, 140.0, 60.0, 0.0, 1e-3), math.inf)
    assert profile_lines("joint_1", lags).startswith("# joint_1: no free resonance found\nchannels:\n")
    assert as_document(lags).free_resonance is None
