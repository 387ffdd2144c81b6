"""`sweepid estimate torque-gain`: two bundles and a known mass give what `identify --torque-gain` takes out."""

import json
from pathlib import Path

import numpy as np
import pytest

from service.cli.commands.estimate import torque_gain
from service.errors import BadInput
from service.recording import Recording, Sine, Sweep, SweepSpec
from service.robot import Axis, RobotDescription, build_robot
from service.store.files.bundle import write_bundle
from sweepid.files import read_gains
from tests.command import sweepid
from tests.unit.service.cli.test_identify import URDF

GAIN, MASS, ARM = 1.05, 8.0, 0.5
INERTIA = 7.0


def _bundle(folder: Path, inertia: float, height: float = 0.2, ratio: float = 100.0) -> Path:
    """Four sweeps of a rigid axis whose drive tells `GAIN` times the torque."""
    axes = (
        Axis(joint="j1", gear_ratio=ratio, motor_inertia=1e-4, rated_effort=100.0, viscous_friction=3.0),
        Axis(joint="j2", gear_ratio=600.0, rated_effort=100.0),
    )
    robot = build_robot(RobotDescription(name="pair", urdf="robot.urdf", axes=axes), URDF)
    sines = tuple(Sine(frequency=f, amplitude=0.01, phase=f) for f in (2.0, 3.0, 4.0, 5.0))
    time = np.arange(2500) / 500.0
    velocity, acceleration, position = np.full(2500, 0.1), np.zeros(2500), 0.1 * time
    for sine in sines:
        omega = 2 * np.pi * sine.frequency
        velocity += sine.amplitude * np.sin(omega * time + sine.phase)
        acceleration += omega * sine.amplitude * np.cos(omega * time + sine.phase)
        position -= sine.amplitude / omega * np.cos(omega * time + sine.phase)
    rng = np.random.default_rng(round(inertia))
    sweeps = [
        Sweep(
            SweepSpec(
                id=f"{number}",
                axis="j1",
                pose=(0.0, height),
                offset_velocity=0.1,
                sines=sines,
                period=1.0,
                periods=5,
                sample_rate=500.0,
                repeat=number,
            ),
            Recording(
                time, GAIN * (inertia * acceleration + 4.0 * velocity) + rng.normal(0, 0.02, 2500), velocity, position
            ),
        )
        for number in range(4)
    ]
    write_bundle(folder, robot, sweeps)
    return folder


def test_a_mass_gives_the_gain_and_the_gain_the_inertia(tmp_path: Path) -> None:
    before, after = _bundle(tmp_path / "a", INERTIA), _bundle(tmp_path / "b", INERTIA + MASS * ARM**2)
    mass = ["--mass", str(MASS), "--center", f"0,{ARM},0"]
    done = sweepid("estimate", "torque-gain", str(before), str(after), *mass, "--json", str(tmp_path / "gains.json"))
    assert done.returncode == 0, done.stderr
    assert "j1" in done.stdout
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


@pytest.mark.parametrize(
    ("mass", "center", "complaint"),
    [
        (8.0, "0,1", "--center: '0,1' is not 3 numbers separated by commas"),
        (8.0, "0,1,nan", "--center: '0,1,nan' is not 3 numbers"),
        (-8.0, "0,1,0", "mass: -8.0 kg is not above 0"),
        (8.0, "0,0,1", "j1: the test mass adds no inertia to this axis in any of the poses"),
    ],
)
def test_bad_input_says_what_is_wrong(tmp_path: Path, mass: float, center: str, complaint: str) -> None:
    before, after = _bundle(tmp_path / "a", INERTIA), _bundle(tmp_path / "b", INERTIA + 2)
    with pytest.raises(BadInput, match=complaint):
        torque_gain(before, after, mass, center)


def test_bundles_that_do_not_belong_together(tmp_path: Path) -> None:
    before = _bundle(tmp_path / "a", INERTIA)
    with pytest.raises(BadInput, match="no axis was swept in the same pose before and after"):
        torque_gain(before, _bundle(tmp_path / "b", INERTIA, height=0.4), 8.0, "0,0.5,0")
    with pytest.raises(BadInput, match="is not of robot"):
        torque_gain(before, _bundle(tmp_path / "c", INERTIA, ratio=90.0), 8.0, "0,0.5,0")


def test_a_mass_that_does_not_show_is_refused(tmp_path: Path) -> None:
    before = _bundle(tmp_path / "a", INERTIA)
    forgotten = sweepid(
        "estimate", "torque-gain", str(before), str(before), "--mass", str(MASS), "--center", f"0,{ARM},0"
    )
    assert (forgotten.returncode, forgotten.stdout) == (2, "")
    assert "j1: the second campaign shows no added inertia beyond its uncertainty" in forgotten.stderr
    assert "check that the mass was mounted, and its units (kg, m)" in forgotten.stderr
    with pytest.raises(BadInput, match="j1: the second campaign shows no added inertia"):
        torque_gain(_bundle(tmp_path / "b", INERTIA + MASS * ARM**2), before, MASS, f"0,{ARM},0")


@pytest.mark.parametrize(("times", "shown"), [(0.4, "0.42"), (2.0, "2.1")])
def test_another_mass_than_the_one_told_is_refused(tmp_path: Path, times: float, shown: str) -> None:
    before, after = _bundle(tmp_path / "a", INERTIA), _bundle(tmp_path / "b", INERTIA + times * MASS * ARM**2)
    with pytest.raises(BadInput, match=rf"j1: the second campaign shows {shown}\d* times .* within 0.5 to 2.0"):
        torque_gain(before, after, MASS, f"0,{ARM},0")


def test_a_center_farther_out_than_the_robot_is_long_is_refused(tmp_path: Path) -> None:
    before, after = _bundle(tmp_path / "a", INERTIA), _bundle(tmp_path / "b", INERTIA + MASS * ARM**2)
    with pytest.raises(BadInput, match=r"--center: is 500 m from the last joint, limit 1 m"):
        torque_gain(before, after, MASS, "0,500,0")


def test_a_gain_must_be_above_zero(tmp_path: Path) -> None:
    gains = tmp_path / "gains.json"
    gains.write_text('{"axes": {"j1": {"gain": {"value": 0, "std": 0.1}}}}')
    with pytest.raises(BadInput, match=r"axes\.j1\.gain\.value"):
        read_gains(gains)
