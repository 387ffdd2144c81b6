"""Inertia and gravity of the plant against Pinocchio, which reads the same real links."""

from collections.abc import Callable

import numpy as np
import pinocchio
import pytest

from simulator import Scenario, ScenarioError, true_inertia
from simulator.rigid_body import RigidBody, real_urdf

POSES = np.random.default_rng(3).uniform(-2.5, 2.5, (20, 6))


@pytest.fixture
def oracle(scenario: Callable[[str], Scenario]) -> pinocchio.Model:
    return pinocchio.buildModelFromXML(real_urdf(scenario("full")))


def test_inertia(scenario: Callable[[str], Scenario], oracle: pinocchio.Model) -> None:
    body = RigidBody(scenario("full"))
    data = oracle.createData()
    for pose in POSES:
        expected = np.diag(pinocchio.crba(oracle, data, pose))
        np.testing.assert_allclose(body.inertia(pose), expected, rtol=1e-9)


def test_gravity_along_the_whole_turn_of_an_axis(scenario: Callable[[str], Scenario], oracle: pinocchio.Model) -> None:
    body = RigidBody(scenario("full"))
    data = oracle.createData()
    for pose in POSES:
        for joint in range(6):
            gravity = body.gravity(joint, pose)
            for angle in (-2.0, 0.0, 0.7, 3.0):
                turned = pose.copy()
                turned[joint] = angle
                expected = pinocchio.computeGeneralizedGravity(oracle, data, turned)[joint]
                assert gravity.at(angle) == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("joint", ["joint_1", "joint_3"])
def test_a_linear_axis(scenario: Callable[[str], Scenario], joint: str) -> None:
    full = scenario("full")
    urdf = full.robot.urdf.replace(f'name="{joint}" type="revolute"', f'name="{joint}" type="prismatic"')
    rail = full.model_copy(update={"robot": full.robot.model_copy(update={"urdf": urdf})})
    body = RigidBody(rail)
    oracle = pinocchio.buildModelFromXML(real_urdf(rail))
    data = oracle.createData()
    number = rail.joints.index(joint)
    for pose in POSES:
        np.testing.assert_allclose(body.inertia(pose), np.diag(pinocchio.crba(oracle, data, pose)), rtol=1e-9)
        expected = pinocchio.computeGeneralizedGravity(oracle, data, pose)[number]
        assert body.gravity(number, pose).at(pose[number]) == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_real_links_differ_from_cad_by_at_most_a_fifth(scenario: Callable[[str], Scenario]) -> None:
    full = scenario("full")
    cad = RigidBody(full.model_copy(update={"links": {}}))
    real = RigidBody(full)
    ratio = np.array([real.inertia(pose)[:3] / cad.inertia(pose)[:3] for pose in POSES])
    assert ratio.max() < 1.2
    assert ratio.min() > 0.8
    assert np.abs(ratio - 1).max(axis=0).min() > 0.02


@pytest.mark.slow
def test_true_inertia_counts_the_motor(scenario: Callable[[str], Scenario]) -> None:
    full = scenario("full")
    motor = 171.0**2 * 0.001995
    loads = [RigidBody(full).inertia(pose)[0] for pose in POSES]
    np.testing.assert_allclose(true_inertia(full, "joint_1", POSES), np.array(loads) + motor, rtol=1e-12)


def test_poses_that_do_not_fit_are_refused(scenario: Callable[[str], Scenario]) -> None:
    with pytest.raises(ScenarioError, match=r"\(2, 3\)"):
        true_inertia(scenario("full"), "joint_1", np.zeros((2, 3)))
    with pytest.raises(ScenarioError, match="finite"):
        true_inertia(scenario("full"), "joint_1", np.full((1, 6), np.nan))


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("</robot>", "", "not XML"),
        ('<mass value="655"/>', "", "link_1"),
        ('<mass value="655"/>', '<mass value="heavy"/>', "link_1"),
        ('<mass value="655"/>', '<mass value="-655"/>', "MuJoCo refuses"),
        ('xyz="0.0027 -0.0284 0.2365" rpy="0 0 0"', 'xyz="0 0 0" rpy="0 0 1"', "turned"),
        ('name="joint_6" type="revolute"', 'name="joint_6" type="fixed"', "joint_6"),
        ('name="joint_1" type="revolute"', 'name="joint_1" type="floating"', "joint_1"),
    ],
)
def test_a_robot_that_cannot_be_simulated_is_refused(
    scenario: Callable[[str], Scenario], old: str, new: str, named: str
) -> None:
    full = scenario("full")
    assert old in full.robot.urdf
    robot = full.robot.model_copy(update={"urdf": full.robot.urdf.replace(old, new)})
    with pytest.raises(ScenarioError, match=named):
        RigidBody(full.model_copy(update={"robot": robot}))
