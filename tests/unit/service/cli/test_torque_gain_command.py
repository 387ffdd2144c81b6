"""`sweepid estimate torque-gain`: two bundles and a known mass give what `identify --torque-gain` takes out."""

import json
from pathlib import Path

import pytest

from service.cli.commands.estimate import torque_gain
from service.errors import BadInput
from sweepid.files import read_gains
from tests.command import carried_out, sweepid
from tests.unit.service.cli.test_identify import rigid_pair

GAIN, MASS, ARM = 1.05, 8.0, 0.5
INERTIA = 7.0


def _bundle(folder: Path, inertia: float, **more: float) -> Path:
    return rigid_pair(folder, inertia, GAIN, **more)


def test_a_mass_gives_the_gain_and_the_gain_the_inertia(tmp_path: Path) -> None:
    before, after = _bundle(tmp_path / "a", INERTIA), _bundle(tmp_path / "b", INERTIA + MASS * ARM**2)
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
        ({"inertia": RIGHT}, {}, MOUNTED, "j1: the second campaign shows no added inertia"),
        ({}, {"inertia": 7.8}, MOUNTED, r"j1: the second campaign shows 0.42\d* times .* within 0.5 to 2.0"),
        ({}, {"inertia": 11.0}, MOUNTED, r"j1: the second campaign shows 2.1\d* times .* within 0.5 to 2.0"),
    ],
)
def test_bad_input_says_what_is_wrong(
    tmp_path: Path, before: dict[str, float], after: dict[str, float], told: tuple[float, str], complaint: str
) -> None:
    folders = [_bundle(tmp_path / str(k), **({"inertia": INERTIA} | made)) for k, made in enumerate((before, after))]
    with pytest.raises(BadInput, match=complaint):
        torque_gain(folders[0], folders[1], *told)


def test_a_mass_that_was_forgotten_is_one_line_and_two(tmp_path: Path) -> None:
    before = _bundle(tmp_path / "a", INERTIA)
    forgotten = sweepid(
        "estimate", "torque-gain", str(before), str(before), "--mass", str(MASS), "--center", f"0,{ARM},0"
    )
    assert (forgotten.returncode, forgotten.stdout) == (2, "")
    assert "j1: the second campaign shows no added inertia beyond its uncertainty" in forgotten.stderr
    assert "check that the mass was mounted, and its units (kg, m)" in forgotten.stderr


def test_a_gain_must_be_above_zero(tmp_path: Path) -> None:
    gains = tmp_path / "gains.json"
    gains.write_text('{"axes": {"j1": {"gain": {"value": 0, "std": 0.1}}}}')
    with pytest.raises(BadInput, match=r"axes\.j1\.gain\.value"):
        read_gains(gains)
