"""The virtual machine that is drafted of a robot is one machine: robot, scenario, drives and settings agree."""

from pathlib import Path

import pytest
import yaml

from drivers.canopen.profile import parse_profile
from drivers.registry import load_profile
from service import BadInput
from service.formats.maker_urdf import side_file_text
from service.formats.maker_urdf.virtual import DraftedRobot, virtual_machine
from service.model.configuration import read_cell, read_robot
from service.planning.machine_setup import DriveProfile, differences
from simulator import load_scenario
from tests.unit.service.maker_urdf.test_kinds import LIMIT, arm, checked, inertial, joint, limit, link

ROOT = Path(__file__).parents[4]
EDS = ROOT / "config/eds/virtual-axis.eds"


def drafted(text: str, folder: Path, **given: float) -> None:
    check = checked(text)
    side = yaml.safe_load(side_file_text(check, "arm", "arm.urdf"))
    for axis in side["axes"]:
        axis |= given
    files = virtual_machine(DraftedRobot.model_validate(side), check.urdf_text, folder.as_posix(), str(EDS), "arm.yaml")
    for path, content in files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(content)


DRAFTED = {
    "plain": arm(),
    "placeholder": arm(l2=link("l2", inertial(1e-6))),
    "no effort": arm(j1=limit("-0.1", "2", effort="0")),
    "no limits": arm(j1='<limit lower="-2" upper="2"/>'),
    "slow": arm(j1=limit("-2", "2", velocity="0.1")),
    "linear": arm().replace('<joint name="j1" type="revolute">', '<joint name="j1" type="prismatic">'),
}


@pytest.mark.parametrize("text", DRAFTED.values(), ids=DRAFTED)
@pytest.mark.parametrize("given", [{}, {"gear_ratio": -50.0, "motor_inertia": 1e-3}], ids=["open", "stated"])
def test_the_files_of_a_virtual_machine_agree(text: str, given: dict[str, float], tmp_path: Path) -> None:
    drafted(text, tmp_path, **given)
    robot = read_robot(tmp_path / "robots/arm-virtual.yaml")
    profile = load_profile(tmp_path / "drives/arm-virtual.yaml")
    assert [axis.joint for axis in parse_profile(profile, tmp_path / "drives").axes] == list(robot.joints)
    assert differences(robot, "robot", DriveProfile.model_validate(profile).of(robot.joints), "drives") == ""
    scenario = load_scenario(tmp_path / "scenarios/arm-virtual.yaml")
    assert set(scenario.axes) == set(robot.joints)
    assert len(read_cell(tmp_path / "cells/arm-virtual.yaml").home_pose(robot.joints)) == 2
    for key, value in given.items():
        assert getattr(robot.axes[0], key) == value
    settings = yaml.safe_load((tmp_path / "service.yaml").read_text())
    assert all(Path(settings[key]).exists() for key in ("drive", "robots_dir", "cells_dir"))


def test_what_cannot_be_a_machine_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"joint j1: effort limit 1 is below its gravity of .*: it cannot hold its lin"):
        drafted(arm(j1=limit("-2", "2", effort="1")), tmp_path)
    side = DraftedRobot.model_validate({"name": "arm", "urdf": "arm.urdf", "axes": [{"joint": "j2"}]})
    with pytest.raises(BadInput, match=r"arm\.yaml axes: differ from the URDF's moving joints: j1, j2"):
        virtual_machine(side, arm(), "x", str(EDS), "arm.yaml")


def test_a_command_drafts_all_files_and_overwrites_none(tmp_path: Path) -> None:
    from tests.command import sweepid

    urdf = tmp_path / "arm.urdf"
    urdf.write_text(arm(more=link("tool") + joint("t", "l2", "tool", LIMIT, "fixed")))
    assert sweepid("robot", "check", str(urdf), "--out", str(tmp_path / "config")).returncode == 0
    command = ("robot", "virtual", str(tmp_path / "config/robots/arm.yaml"), "--eds", str(EDS))
    done = sweepid(*command)
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.splitlines()) == 6
    assert f"sweepid serve --config {tmp_path / 'config/arm-virtual/service.yaml'}" in done.stderr
    again = sweepid(*command)
    assert (again.returncode, "nothing is overwritten" in again.stderr) == (2, True)
    none = sweepid(*command[:3], "--eds", str(tmp_path / "none.eds"), "--out", str(tmp_path / "o"))
    assert "--eds: there is no file" in none.stderr
