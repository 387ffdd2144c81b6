"""`sweepid identify` as a person calls it: tables or JSON on stdout, one line and exit code 2 for bad input."""

import json
import re
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from service.cli.terminal import print_result
from service.identification.estimates.initial_analysis import analyses_document
from service.model import Axis, RobotDescription, build_robot
from service.model.results.estimate import Estimate
from service.store.files.bundle import write_bundle
from tests.command import carried_out, refused, sweepid
from tests.formula_sweep import Turning, by_formula, lines
from tests.stored.documents import stored
from tests.unit.service.identification.known import model
from tests.unit.service.identification.test_ideal_frequency import STIFF, analysis

INERTIA = 6.0  # kg m^2 of the load about the first axis; CAD says 5, the second link included; motor 100^2 0.0001 = 1

URDF = """<robot name="pair">
  <link name="base"/>
  <link name="one">
    <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="4" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <link name="two">
    <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <joint name="j1" type="revolute"><parent link="base"/><child link="one"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="1" effort="100"/></joint>
  <joint name="j2" type="prismatic"><parent link="one"/><child link="two"/>
    <axis xyz="0 0 1"/><limit lower="0" upper="1" velocity="1" effort="100"/></joint>
</robot>
"""


def rigid_pair(folder: Path, inertia: float, gain: float = 1.0, height: float = 0.2, ratio: float = 100.0) -> Path:
    """Four sweeps of a rigid axis whose drive tells `gain` times the torque. `inertia`: with the motor, kg m^2."""
    axes = (
        Axis(joint="j1", gear_ratio=ratio, motor_inertia=1e-4, rated_effort=100.0, viscous_friction=3.0),
        Axis(joint="j2", gear_ratio=600.0, rated_effort=100.0),
    )
    robot = build_robot(RobotDescription(name="pair", urdf="robot.urdf", axes=axes), URDF)
    random = np.random.default_rng(round(inertia))

    def effort(m: Turning) -> np.ndarray:
        return gain * (inertia * m.acceleration + 4.0 * m.velocity) + random.normal(0, 1e-3, len(m.time))

    told = {"axis": "j1", "pose": (0.0, height), "offset_velocity": 0.1, "sines": lines((2.0, 3.0, 4.0, 5.0), 0.01)}
    sweeps = [by_formula(effort, 5.0, **told, id=str(number), repeat=number, periods=5) for number in range(4)]
    write_bundle(folder, robot, sweeps)
    return folder


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    return rigid_pair(tmp_path / "bundle", INERTIA + 1)


def test_json_alone_on_stdout(bundle: Path) -> None:
    document = json.loads(carried_out("identify", str(bundle), "--json", "-"))
    assert set(document) >= {"axes", "base_parameters", "condition_number", "standard_parameters"}
    values = [sweep["value"] for sweep in document["axes"]["j1"]["inertia"]]
    assert values == pytest.approx([INERTIA + 1] * 4, rel=1e-3)
    rmse = document["axes"]["j1"]["rmse_percent"]
    assert rmse["reference_measured"] == pytest.approx(100 / 7, rel=1e-2)  # CAD is 1 of 7 short
    assert rmse["identified_measured"] < 0.1


def test_tables_for_people_and_json_for_a_file(bundle: Path, tmp_path: Path) -> None:
    told = carried_out("identify", str(bundle), "--axis", "j1", "--json", str(tmp_path / "out.json"))
    for word in ("j1", "14.29", "Base parameters", "Condition number"):
        assert word in told
    assert json.loads((tmp_path / "out.json").read_text())["axes"].keys() == {"j1"}


def test_known_effects_of_a_model_are_taken_into_account_and_told(bundle: Path, tmp_path: Path) -> None:
    told = model(j1={"coulomb_friction": {"coulomb": (1.0, 0.1)}, "backlash": {"gap": (1e-3, 1e-4)}})
    (tmp_path / "model.json").write_text(json.dumps(told))
    done = sweepid("identify", str(bundle), "--model", str(tmp_path / "model.json"), "--json", str(tmp_path / "out"))
    assert done.returncode == 0, done.stderr
    assert "Taken into account: coulomb_friction of j1, its torque at the measured velocity" in done.stdout
    assert "Left out: backlash of j1" in done.stdout
    document = json.loads((tmp_path / "out").read_text())
    assert document["model"] == {"file": "model.json"}
    assert [(effect["effect"], effect["used"]) for effect in document["effects"]] == [
        ("coulomb_friction", True),
        ("backlash", False),
    ]
    assert document["axes"]["j1"]["effects_moved_in_std"] < 1e-6  # nothing reverses: no line shows it


@pytest.mark.parametrize(
    ("text", "arguments", "reason"),
    [
        ("no json", ["--model", "model.json"], "model.json: cannot be read as JSON"),
        (
            '{"axes": {"j9": {}}}',
            ["--model", "model.json"],
            "model.json: model.axes.j9: is not a joint of the robot; its joints are j1, j2",
        ),
        ("", ["--axis", "j3"], "j3: unknown joint; robot pair has j1, j2"),
        ("", ["--axis", "j2"], "has no sweep of joint j2"),
        ("", ["--json", "/dev/null/folder.json"], "/dev/null/folder.json: cannot be written: Not a directory"),
    ],
)
def test_bad_input_is_one_line_and_two(
    bundle: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, arguments: list[str], reason: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "model.json").write_text(text)
    assert reason in refused("identify", str(bundle), *arguments).splitlines()[-1]


def test_a_broken_bundle_is_told_by_file_and_sweep(bundle: Path) -> None:
    (bundle / "sweeps/0003.parquet").unlink()
    done = sweepid("identify", str(bundle), "--json", "-")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.strip().endswith("0003.parquet sweep 2: file does not exist")
    assert done.stderr.count("\n") == 1


def test_a_locked_rotor_above_the_band_is_told_as_such() -> None:
    written = StringIO()
    analyses = analyses_document({"swing": analysis(train=STIFF)})
    found = Estimate.read(stored("analysis"), "estimate").model_copy(update={"analysis": analyses})
    print_result(found, Console(file=written, width=200))
    rows = [line for line in written.getvalue().splitlines() if "swing" in line]
    assert len(rows) == 4
    for row in rows:
        assert "above 38.75 " in row
        assert re.search(r"above \d\.\d+ .* [2345] ", row)
        assert "inf" not in row


def test_every_bundle_has_a_report(bundle: Path, tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    done = sweepid("identify", str(bundle), "--report", str(page))
    assert (done.returncode, done.stderr) == (0, "")
    text = page.read_text("utf-8")
    for words in ("Inertias of the robot pair", "from 4 sweeps", "RMSE in %", "Base parameters"):
        assert words in text
