"""Collision checks against distances worked out by hand on a two-link arm."""

import os
import re
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from service import BadInput
from service.model import build_robot
from service.model.collision import CollisionChecker, compiled, reachable
from service.model.configuration import Box, Cell, read_cell, read_robot
from tests.unit.service.campaigns.small_arm import small_arm

CLEARANCE = 0.05


def checker(**cell: object) -> CollisionChecker:
    return CollisionChecker(small_arm(), Cell.model_validate({"name": "test", "clearance": CLEARANCE, **cell}))


RACK = Box(name="rack", center=(0.0, 1.0, 1.0), size=(4.0, 0.2, 0.2))
AHEAD = Box(name="rack", center=(2.5, 0.0, 1.0), size=(0.2, 2.0, 0.2), yaw=np.pi / 2)
# the arm hangs straight out and down by q: the tool's centre is 2 sin(q) below the shoulder, its radius 0.15
LIMIT = float(np.arcsin((1.0 - 0.15 - CLEARANCE) / 2.0))


@pytest.mark.parametrize(
    ("cell", "poses", "free"),
    [
        ({}, [[0.0, 0.0], [-1.0, 0.5], [-1.5, 0.0]], [True, True, True]),  # neighbours do not count
        ({}, [[0.4, 2.75]], [False]),  # folded back by 150 degrees and turned down, the tool enters the base's box
        ({"floor": 0.0}, [[LIMIT - 0.002, 0.0], [LIMIT + 0.002, 0.0]], [True, False]),
        ({"boxes": (RACK,)}, [[0.0, 0.0]], [True]),
        ({"boxes": (RACK.model_copy(update={"yaw": np.pi / 2}),)}, [[0.0, 0.0]], [False]),
        ({"boxes": (AHEAD,)}, [[0.0, 0.0]], [False]),
    ],
)
def test_what_is_free(cell: dict[str, object], poses: list[list[float]], free: list[bool]) -> None:
    assert checker(**cell).collision_free(np.array(poses)).tolist() == free


def test_no_free_pose_is_nearer_to_an_obstacle_than_the_clearance(root: Path) -> None:
    robot, cell = read_robot(root / "config/robots/max100-class.yaml"), read_cell(root / "config/cells/workshop.yaml")
    model = compiled(robot, cell)
    data = mujoco.MjData(model)
    standing, links = (
        np.flatnonzero(model.geom_bodyid == 0),
        np.flatnonzero(model.geom_bodyid > 2),
    )  # after base, link_1
    limits = np.array([(joint.lower, joint.upper) for joint in robot.chain.joints])
    poses = np.random.default_rng(1).uniform(limits[:, 0], limits[:, 1], (1500, 6))
    free = CollisionChecker(robot, cell).collision_free(poses)
    assert 500 < free.sum() < 1500
    for pose in poses[free]:
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        pairs = [(int(one), int(other)) for one in standing for other in links]
        assert min(mujoco.mj_geomDistance(model, data, *pair, 1.0, None) for pair in pairs) > 0.999 * cell.clearance


def test_leg_sees_an_obstacle_between_free_ends() -> None:
    pole = Box(name="pole", center=(2.0, 0.0, 1.0), size=(0.02, 0.02, 0.02))
    check = checker(boxes=(pole,))
    ends = np.array([[-0.3, 0.0], [0.3, 0.0]])
    assert check.collision_free(ends).all()
    assert not check.leg_free(ends[0], 0, 0.3)
    assert check.leg_free(ends[0], 0, -1.0)


def test_leg_step_bounds_the_motion_of_the_farthest_point() -> None:
    # joint 1: upper arm 1 m, tool at 1 m with its shape beyond it
    step = checker().step
    assert step[0] * (1.0 + 1.0 + 0.15) <= CLEARANCE * 1.0001
    assert step[1] > step[0]


def test_travel_agrees_with_single_legs() -> None:
    check = checker(floor=0.0)
    poses = np.array([[q1, q2] for q1 in np.linspace(-2.0, 1.0, 13) for q2 in np.linspace(-2.0, 2.0, 9)])
    for joint, travel in ((0, 0.07), (1, -0.07)):
        many = check.travel_free(poses, joint, travel)
        single = [check.leg_free(pose, joint, pose[joint] + travel) for pose in poses]
        assert many.tolist() == single
        assert 0 < many.sum() < len(poses)


def test_unknown_link_is_named() -> None:
    with pytest.raises(BadInput, match="no link hand"):
        checker(ignored_pairs=(("upper", "hand"),))


def test_what_nests_where_the_robot_stood_does_not_count_offline(root: Path) -> None:
    robot = read_robot(root / "config/robots/max100-class.yaml")
    stood, folded = np.zeros((1, 6)), np.array([[0.0, 1.2, 2.2, 0.0, 0.0, 0.0]])
    assert reachable(robot, stood, np.vstack([stood, folded])).tolist() == stood.tolist()


def test_a_path_of_all_axes_at_once_is_sampled_finely() -> None:
    # both ends are free, half-way the tool meets a small box
    ends = np.array([[-0.8, -0.6], [0.0, 0.6]])
    middle = ends.mean(axis=0)
    angles = np.cumsum(middle)
    tool = np.cos(angles).sum(), 1.0 - np.sin(angles).sum()
    box = Box(name="post", center=(tool[0], 0.0, tool[1]), size=(0.05, 0.05, 0.05))
    looked = checker(boxes=(box,))
    assert looked.collision_free(ends).all()
    assert not looked.path_free(ends)
    assert checker().path_free(ends)
    assert checker().path_free(ends[:1])


def test_a_mesh_is_refused_and_not_opened(tmp_path: Path) -> None:
    """Opening the pipe would wait for who writes into it."""
    arm, pipe = small_arm(), tmp_path / "shape.stl"
    os.mkfifo(pipe)
    shape = f'<collision><geometry><mesh filename="{pipe}"/></geometry></collision>'
    urdf = arm.urdf_text.replace("</link>", f"{shape}</link>", 1)
    with pytest.raises(BadInput, match=r"link base: mesh .*shape\.stl: its shape is not in the URDF"):
        CollisionChecker(replace(arm, urdf_text=urdf), Cell(name="empty"))


def test_a_mesh_is_met_where_the_same_box_is() -> None:
    """The base of the small arm as a mesh with its hull: the same verdict in every pose."""
    box = small_arm()
    size = re.search(r'<box size="([^"]+)"', box.urdf_text)
    assert size is not None
    half = np.array([float(edge) for edge in size[1].split()]) / 2
    corners = half * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    hull = " ".join(f"{number:.6g}" for number in corners.ravel())
    mesh = box.urdf_text.replace(f"{size[0]}/>", f'<mesh filename="package://a/b.stl"><hull vertices="{hull}"/></mesh>')
    assert mesh.count("<hull") == box.urdf_text.count(size[0])
    poses = np.random.default_rng(1).uniform([-1.5, -2.8], [1.5, 2.8], (400, 2))
    cell = Cell(name="test", clearance=CLEARANCE, floor=0.0, boxes=(Box(name="r", center=(1, 1, 1), size=(1, 0.2, 1)),))
    checkers = [CollisionChecker(one, cell) for one in (box, build_robot(box.description, mesh))]
    free = [one.collision_free(poses) for one in checkers]
    assert 0.1 < free[0].mean() < 0.9
    np.testing.assert_array_equal(free[0], free[1])
    np.testing.assert_allclose(checkers[1].step, checkers[0].step, rtol=1e-6)


@pytest.mark.parametrize("shape", ['<box size="0 0 0"/>', '<box size="1 x"/>'])
def test_a_shape_that_cannot_be_read_is_told(shape: str) -> None:
    arm = small_arm()
    text = re.sub(r"<(box|cylinder|sphere) [^>]*/>", shape, arm.urdf_text)
    with pytest.raises(BadInput, match="collision shapes cannot be read"):
        CollisionChecker(build_robot(arm.description, text), Cell(name="test"))
