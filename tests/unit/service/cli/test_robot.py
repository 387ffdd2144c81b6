"""`sweepid robot check`: what it tells of a maker's URDF, and drafts that lead to a plan once they are completed."""

import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from service import BadInput
from service.model.collision import CollisionChecker
from service.model.configuration import read_cell, read_robot
from tests.command import carried_out, refused, sweepid
from tests.makers_robots import MAKERS, Maker, share, told_of

pytestmark = pytest.mark.slow

ROBOTS = share() / "example-robot-data" / "robots"
UR5 = str(ROBOTS / "ur_description/urdf/ur5_robot.urdf")
PANDA = str(ROBOTS / "panda_description/urdf/panda.urdf")


def words(text: str) -> str:
    """What a table says, without its frame; a cell that is folded reads in parts."""
    return " ".join(re.sub(r"[^\x20-\x7e]", " ", text).split())


def test_a_urdf_is_looked_at_and_nothing_is_written(tmp_path: Path) -> None:
    said = words(carried_out("robot", "check", UR5, "--packages", str(share())))
    assert "ur5: 6 axes, shoulder_pan_joint to wrist_3_joint" in said
    for told in (
        "gear ratio",
        "rated effort",
        "motor inertia",
        "cogging orders",
        "collision meshes",
        "treated as nested",
    ):
        assert told in said
    assert list(tmp_path.iterdir()) == []


def test_without_packages_every_mesh_is_missing_and_nothing_is_drafted(tmp_path: Path) -> None:
    assert words(carried_out("robot", "check", UR5)).count("no such file") == 7
    assert "ur5/collision/base.stl: no such file in the package folders (none was given)" in refused(
        "robot", "check", UR5, "--out", str(tmp_path)
    )
    assert list(tmp_path.iterdir()) == []


def test_drafts_are_read_when_they_are_completed_and_are_not_overwritten(tmp_path: Path) -> None:
    command = ("robot", "check", UR5, "--packages", str(share()), "--name", "my-ur5", "--out", str(tmp_path))
    done = sweepid(*command)
    assert done.returncode == 0, done.stderr
    drafts = [tmp_path / name for name in ("robots/my-ur5.urdf", "robots/my-ur5.yaml", "cells/my-ur5.yaml")]
    assert done.stdout.splitlines() == [str(path) for path in drafts]
    side = drafts[1]
    with pytest.raises(BadInput, match=r"axes\.0\.gear_ratio"):
        read_robot(side)
    text = side.read_text().replace("gear_ratio: null", "gear_ratio: 101.0")
    side.write_text(text.replace("rated_effort: null", "rated_effort: 60.0"))
    robot, cell = read_robot(side), read_cell(drafts[2])
    home = cell.home_pose(robot.joints)
    assert CollisionChecker(robot, cell).collision_free(np.array([home])).all()
    again = sweepid(*command)
    assert (again.returncode, "nothing is overwritten" in again.stderr) == (2, True)


def test_several_chains_ask_for_a_tip() -> None:
    assert "choose the end of one by --tip: panda_hand (7 axes)" in refused(
        "robot", "check", PANDA, "--packages", str(share())
    )


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("<xacro/>", "is not a URDF: begins with <xacro>, not <robot>"),
        ("<robot", "not XML"),
        ('<robot name="r"><link name="a"/></robot>', "has no moving joint"),
        (
            f"<robot>{''.join(f'<link name={chr(34)}l{k}{chr(34)}/>' for k in range(201))}</robot>",
            "has 201 links, limit 200",
        ),
    ],
)
def test_what_is_no_robot_is_told(tmp_path: Path, content: str, told: str) -> None:
    path = tmp_path / "r.urdf"
    path.write_text(content)
    assert told in refused("robot", "check", str(path))


def test_a_name_that_leads_elsewhere_is_refused(tmp_path: Path) -> None:
    assert "is not a file name" in refused(
        "robot", "check", UR5, "--packages", str(share()), "--name", "../x", "--out", str(tmp_path / "out")
    )


ODD = {  # what a person should know of each before it is measured
    "ur5": "changed: 7 collision meshes are used as convex hulls",
    "ur10": "changed: 7 collision meshes are used as convex hulls",
    "panda": "changed: follows panda_finger_joint1 (<mimic>): fixed at 0",
    "xarm7": "changed: 8 collision meshes are used as convex hulls",
    "kinova": "changed: turns without end (continuous): limited to half a turn either way",
    "z1": "unusual: moves but has no collision shape",
    "tiago": "unusual: no body has its principal inertias",
    "alex": "changed: is not between base and tip: fixed at 0",
}


@pytest.mark.slow
@pytest.mark.parametrize("maker", MAKERS, ids=lambda maker: maker.name)
def test_what_is_odd_about_a_makers_urdf_is_told(maker: Maker) -> None:
    told = told_of(maker)
    assert told.lacking == ()
    assert any(f"{one.kind}: {one.sentence}".startswith(ODD[maker.name]) for one in told.findings)
    assert set(maker.axes) <= {joint.name for joint in told.chain.joints}


def test_the_side_file_says_that_inertials_are_guessed(tmp_path: Path) -> None:
    joint = '<joint name="j" type="revolute"><parent link="a"/><child link="b"/>'
    shape = '<collision><geometry><box size="0.2 0.4 0.1"/></geometry></collision>'
    path = tmp_path / "r.urdf"
    path.write_text(
        f'<robot name="r"><link name="a"/><link name="b">{shape}</link>'
        f'{joint}<limit lower="-1" upper="1" velocity="1" effort="9"/></joint></robot>'
    )
    done = sweepid("robot", "check", str(path), "--out", str(tmp_path / "config"))
    assert done.returncode == 0, done.stderr
    text = (tmp_path / "config/robots/r.yaml").read_text()
    assert "# the inertials of b are guesses, placeholders" in text
    assert yaml.safe_load(text)["prior"]["inertia"] == 1.0
    assert "has no <inertial>: 8 kg" in words(done.stderr)
