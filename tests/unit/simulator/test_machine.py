"""The live machine: brakes, closed loop, limits, noise, seeds; its rigid body against Pinocchio."""

from collections.abc import Callable

import numpy as np
import pinocchio
import pytest

from simulator import Scenario, ScenarioError, true_inertia
from simulator.machine import LiveMachine
from simulator.rigid_body import RigidBody, real_urdf

STILL = np.zeros((500, 6))
Load = Callable[[str], Scenario]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["full", "rigid", "misfit"])
def test_an_axis_stands_under_gravity_braked_and_in_closed_loop(noise_free: Load, name: str) -> None:
    machine = LiveMachine(noise_free(name), seed=1)
    machine.set_position("joint_2", 0.9)
    braked = machine.advance(STILL)
    assert np.ptp(braked.position[:, 1]) == 0
    assert np.all(braked.effort == 0)
    machine.energise("joint_2", True)
    held = machine.advance(STILL)
    assert np.ptp(held.position[:, 1]) < 1e-5
    assert np.abs(held.velocity[-100:, 1]).max() < 1e-6
    assert held.effort[-1, 1] == pytest.approx(-2720, rel=0.01)  # the arm leans forward


def test_small_calls_equal_one_large_call(noise_free: Load) -> None:
    setpoints = np.zeros((200, 6))
    setpoints[:, 2] = np.linspace(0, 0.02, 200)
    whole, pieces = (LiveMachine(noise_free("misfit"), seed=1) for _ in range(2))
    whole.energise("joint_3", True)
    pieces.energise("joint_3", True)
    expected = whole.advance(setpoints)
    parts = [pieces.advance(setpoints[k : k + 4]) for k in range(0, 200, 4)]
    np.testing.assert_allclose(np.concatenate([p.effort for p in parts]), expected.effort, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(np.concatenate([p.position for p in parts]), expected.position, rtol=1e-12)


def test_torque_limit_holds_and_is_reported(noise_free: Load) -> None:
    machine = LiveMachine(noise_free("full"), seed=1)
    machine.set_effort_limit("joint_1", 400.0)
    machine.energise("joint_1", True)
    step = np.zeros((300, 6))
    step[:, 0] = 0.3
    samples = machine.advance(step)
    assert np.abs(samples.effort[:, 0]).max() <= 400.0
    assert samples.torque_limited[:50, 0].any()
    assert not samples.torque_limited[:, 1:].any()
    with pytest.raises(ScenarioError, match="negative"):
        machine.set_effort_limit("joint_1", -1.0)


def test_noise_and_steps_of_the_torque(scenario: Load) -> None:
    machine = LiveMachine(scenario("full"), seed=5)
    samples = machine.advance(np.zeros((4000, 6)))
    rated = np.array([axis.rated_effort for axis in machine.axes[:3]])
    np.testing.assert_allclose(samples.effort[:, :3].std(axis=0), 0.002 * rated, rtol=0.05)
    steps = samples.effort[:, :3] / (0.001 * rated)
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    np.testing.assert_allclose(samples.velocity[:, :3].std(axis=0), 5e-6, rtol=0.05)


def test_what_cannot_be_done_is_refused(scenario: Load) -> None:
    machine = LiveMachine(scenario("full"), seed=1)
    assert [axis.locked for axis in machine.axes] == [False] * 3 + [True] * 3
    with pytest.raises(ScenarioError, match="joint_5"):
        machine.energise("joint_5", True)
    machine.energise("joint_1", True)
    assert machine.energised("joint_1")
    with pytest.raises(ScenarioError, match="energised"):
        machine.set_position("joint_1", 0.1)
    with pytest.raises(ValueError, match=r"\(cycles, 6\)"):
        machine.advance(np.zeros((3, 2)))


POSES = np.random.default_rng(3).uniform(-2.5, 2.5, (20, 6))


@pytest.fixture(params=["", "joint_1", "joint_3"], ids=["all turn", "joint_1 is linear", "joint_3 is linear"])
def plant(scenario: Load, request: pytest.FixtureRequest) -> Scenario:
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


def test_poses_that_do_not_fit_are_refused(scenario: Load) -> None:
    for poses, text in ((np.zeros((2, 3)), r"\(2, 3\)"), (np.full((1, 6), np.nan), "finite")):
        with pytest.raises(ScenarioError, match=text):
            true_inertia(scenario("full"), "joint_1", poses)


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
def test_a_robot_that_cannot_be_simulated_is_refused(scenario: Load, old: str, new: str, named: str) -> None:
    full = scenario("full")
    assert old in full.robot.urdf
    robot = full.robot.model_copy(update={"urdf": full.robot.urdf.replace(old, new)})
    with pytest.raises(ScenarioError, match=named):
        RigidBody(full.model_copy(update={"robot": robot}))
