"""Inertia and gravity of the plant against Pinocchio, which reads the same real links."""

from collections.abc import Callable

import numpy as np
import pinocchio
import pytest

from simulator import Scenario, ScenarioError, true_inertia
from simulator.rigid_body import RigidBody, real_urdf

POSES = np.random.default_rng(3).uniform(-2.5, 2.5, (20, 6))


@pytest.fixture(params=["", "joint_1", "joint_3"], ids=["all turn", "joint_1 is linear", "joint_3 is linear"])
def plant(scenario: Callable[[str], Scenario], request: pytest.FixtureRequest) -> Scenario:
    full, rail = scenario("full"), f'name="{request.param}" type='
    urdf = full.robot.urdf.replace(f'{rail}"revolute"', f'{rail}"prismatic"')
    return full.model_copy(update={"robot": full.robot.model_copy(update={"urdf": urdf})})


def test_inertia_and_gravity_along_the_whole_way_of_each_axis(plant: Scenario) -> None:
    body, oracle = RigidBody(plant), pinocchio.buildModelFromXML(real_urdf(plant))
    data = oracle.createData()
    for pose in POSES:
        np.testing.assert_allclose(body.inertia(pose), np.diag(pinocchio.crba(oracle, data, pose)), rtol=1e-9)
        for joint in range(6):
            gravity = body.gravity(joint, pose)
            for position in (pose[joint], -2.0, 0.0, 0.7, 3.0):
                moved = pose.copy()
                moved[joint] = position
                expected = pinocchio.computeGeneralizedGravity(oracle, data, moved)[joint]
                assert gravity.at(position) == pytest.approx(expected, rel=1e-9, abs=1e-9)


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
