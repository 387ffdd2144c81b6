"""`sweepid estimate` as a person calls it: benefit, channels, torque-gain."""

import json
import math
from pathlib import Path

import pytest
import yaml

from service import BadInput
from service.cli.commands.estimate import as_document, profile_lines, torque_gain
from service.identification.axis.channel_timing import ChannelLags, Lag
from service.identification.axis.drive_train import TwoMassTrain
from service.report.benefit.benefit import Benefit
from service.store.files.bundle import write_bundle
from sweepid.files import read_gains
from tests.command import carried_out, refused, sweepid
from tests.numeric.campaign import max100
from tests.numeric.test_channel_timing import CALIBRATION, lagging, swept
from tests.unit.service.benefit import pair
from tests.unit.service.cli.test_identify import rigid_pair


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("worth") / "bundle"
    write_bundle(path, pair.robot(), pair.sweeps([0.0, 0.3, 0.6, 0.2, 0.9, 0.5, 0.1, 0.8]))
    return path


def side_file(folder: Path, text: str) -> Path:
    """The pair's own robot file with another URDF."""
    (folder / "cad.urdf").write_text(text)
    description = pair.robot().description.model_dump(mode="json") | {"urdf": "cad.urdf"}
    (folder / "cad.yaml").write_text(yaml.safe_dump(description))
    return folder / "cad.yaml"


def test_a_table_for_people_in_80_columns_without_a_shortened_word(bundle: Path) -> None:
    done = sweepid("estimate", "benefit", str(bundle))
    assert done.returncode == 0, done.stderr
    told = " ".join(done.stdout.split())
    for words in ("CAD", "estimate", "j1: 2 sweeps in 2 of 8 poses held out (every 4th)", "one false alarm in 8 h"):
        assert words in told
    assert max(len(line) for line in done.stdout.splitlines()) <= 80
    assert "…" not in told
    assert "times less" not in told


def test_json_alone_on_stdout(bundle: Path) -> None:
    told = carried_out("estimate", "benefit", str(bundle), "--json", "-")
    found = Benefit.read(json.loads(told), "benefit")
    assert found.axes["j1"].held_out == ("0004", "0008")
    assert found.axes["j1"].cad.inertia_percent.value > 20
    assert found.as_json() == json.loads(told)


def test_cad_may_come_from_a_file(bundle: Path, tmp_path: Path) -> None:
    right = pair.URDF.replace(
        '<link name="slide">\n    <inertial><mass value="1"/>', '<link name="slide">\n    <inertial><mass value="2"/>'
    )
    told = carried_out("estimate", "benefit", str(bundle), "--robot", str(side_file(tmp_path, right)), "--json", "-")
    assert Benefit.read(json.loads(told), "benefit").axes["j1"].cad.inertia_percent.value < 0.05


def test_cad_of_another_robot_is_refused(bundle: Path, root: Path) -> None:
    assert "emps.yaml: has joints slide, but the robot of the bundle has j1, j2" in refused(
        "estimate", "benefit", str(bundle), "--robot", str(root / "config/robots/emps.yaml")
    )


def test_too_few_poses_are_told(tmp_path: Path) -> None:
    write_bundle(tmp_path / "bundle", pair.robot(), pair.sweeps([0.0, 0.3, 0.6]))
    assert "has no axis that can be evaluated: j1 has sweeps in 3 poses; every 4th is held out" in refused(
        "estimate", "benefit", str(tmp_path / "bundle")
    )


@pytest.fixture(scope="module")
def calibration(tmp_path_factory: pytest.TempPathFactory) -> Path:
    robot = max100()
    path = tmp_path_factory.mktemp("calibration") / "calibration"
    write_bundle(path, robot, swept(lagging("effort"), robot, "joint_1", CALIBRATION, poses=2, seed=5))
    return path


def test_the_lines_for_the_profile_and_the_document_say_the_same(calibration: Path, tmp_path: Path) -> None:
    target = tmp_path / "channels.json"
    done = sweepid("estimate", "channels", str(calibration), "--axis", "joint_1", "--json", str(target))
    assert (done.returncode, done.stderr) == (0, "")
    effort = json.loads(target.read_text())["axes"]["joint_1"]["effort"]
    assert effort["apart"] is True
    for name, truth in (("delay", 1e-3), ("smoothing", 2e-3), ("total", 3e-3)):
        assert abs(effort[name]["value"] - truth) < 3 * effort[name]["std"]
    channels = yaml.safe_load(done.stdout)["channels"]
    assert channels["effort_delay"] == pytest.approx(effort["delay"]["value"], abs=1e-7)
    assert channels["effort_smoothing"] == pytest.approx(effort["smoothing"]["value"], abs=1e-7)
    assert set(channels) == {"effort_delay", "effort_smoothing", "velocity_delay", "velocity_smoothing"}


def test_an_axis_without_sweeps_is_bad_input(calibration: Path) -> None:
    done = sweepid("estimate", "channels", str(calibration), "--axis", "joint_2")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == f"sweepid: {calibration}: has no sweep with sines of joint joint_2\n"


def test_what_cannot_be_told_apart_or_does_not_resonate_is_said() -> None:
    lag = Lag(5e-4, 1e-5, 0.0, 2e-4, 5e-4, 1e-5, apart=False)
    text = profile_lines("joint_1", ChannelLags(lag, lag, TwoMassTrain(58.0, 140.0, 60.0, 1e-6, 1e-3), 21.3))
    assert "effort_delay: 0.0005000 # s, +- 1e-05, delay and smoothing together: they cannot be separated" in text
    assert yaml.safe_load(text)["channels"]["effort_smoothing"] == 0.0
    lags = ChannelLags(lag, lag, TwoMassTrain(58.0, 140.0, 60.0, 0.0, 1e-3), math.inf)
    assert profile_lines("joint_1", lags).startswith("# joint_1: no free resonance found\nchannels:\n")
    assert as_document(lags).free_resonance is None


GAIN, MASS, ARM = 1.05, 8.0, 0.5
INERTIA = 7.0


def _sweeps(folder: Path, inertia: float, **more: float) -> Path:
    return rigid_pair(folder, inertia, GAIN, **more)


def test_a_mass_gives_the_gain_and_the_gain_the_inertia(tmp_path: Path) -> None:
    before, after = _sweeps(tmp_path / "a", INERTIA), _sweeps(tmp_path / "b", INERTIA + MASS * ARM**2)
    mass = ["--mass", str(MASS), "--center", f"0,{ARM},0"]
    assert "j1" in carried_out(
        "estimate", "torque-gain", str(before), str(after), *mass, "--json", str(tmp_path / "gains.json")
    )
    axis = json.loads((tmp_path / "gains.json").read_text())["axes"]["j1"]
    assert axis["gain"]["value"] == pytest.approx(GAIN, rel=0.01)
    assert axis["gain"]["std"] < 0.01
    assert axis["poses"] == 1
    assert axis["added_inertia"] == pytest.approx(MASS * ARM**2)

    gains = ["--torque-gain", str(tmp_path / "gains.json"), "--json", "-"]
    told, known = (
        json.loads(sweepid("identify", str(before), *options).stdout)["axes"]["j1"]["inertia"][0]
        for options in (["--json", "-"], gains)
    )
    assert told["value"] == pytest.approx(GAIN * INERTIA, rel=0.01)
    assert known["value"] == pytest.approx(INERTIA, rel=0.01)
    assert known["std_total"] < 0.3 * told["std_total"]


RIGHT = INERTIA + MASS * ARM**2  # with the mass
MOUNTED = (8.0, "0,0.5,0")


@pytest.mark.parametrize(
    ("before", "after", "told", "complaint"),
    [
        ({}, {"inertia": 9.0}, (8.0, "0,1"), "--center: '0,1' is not 3 numbers separated by commas"),
        ({}, {"inertia": 9.0}, (8.0, "0,1,nan"), "--center: '0,1,nan' is not 3 numbers"),
        ({}, {"inertia": 9.0}, (-8.0, "0,1,0"), "mass: -8.0 kg is not above 0"),
        ({}, {"inertia": 9.0}, (8.0, "0,0,1"), "j1: the test mass adds no inertia to this axis in any of the poses"),
        ({}, {"inertia": RIGHT}, (8.0, "0,500,0"), r"--center: is 500 m from the last joint, limit 1 m"),
        ({}, {"height": 0.4}, MOUNTED, "no axis was swept in the same pose before and after"),
        ({}, {"ratio": 90.0}, MOUNTED, "is not of robot"),
        (
            {"inertia": RIGHT},
            {},
            MOUNTED,
            r"j1: .* no added inertia .*: check that the mass was mounted, and its units \(kg, m\)",
        ),
        ({}, {"inertia": 7.8}, MOUNTED, r"j1: the second campaign shows 0.42\d* times .* within 0.5 to 2.0"),
        ({}, {"inertia": 11.0}, MOUNTED, r"j1: the second campaign shows 2.1\d* times .* within 0.5 to 2.0"),
    ],
)
def test_bad_input_says_what_is_wrong(
    tmp_path: Path, before: dict[str, float], after: dict[str, float], told: tuple[float, str], complaint: str
) -> None:
    folders = [_sweeps(tmp_path / str(k), **({"inertia": INERTIA} | made)) for k, made in enumerate((before, after))]
    with pytest.raises(BadInput, match=complaint):
        torque_gain(folders[0], folders[1], *told)


def test_a_gain_must_be_above_zero(tmp_path: Path) -> None:
    gains = tmp_path / "gains.json"
    gains.write_text('{"axes": {"j1": {"gain": {"value": 0, "std": 0.1}}}}')
    with pytest.raises(BadInput, match=r"axes\.j1\.gain\.value"):
        read_gains(gains)
