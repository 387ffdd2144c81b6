"""Axes of one robot that feel each other: at rest, alone, together with the exact inverse dynamics, refusals."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from simulator import Friction, Scenario, ScenarioError, SweepRun, run_sweeps, run_trajectories
from simulator.coupled import CoupledTrains
from simulator.machine import Machine
from simulator.rigid_body import real_urdf
from simulator.scenario import STEP

pytestmark = pytest.mark.slow

Load = Callable[[str], Scenario]
POSE = (0.2, 0.3, -0.6, 0.4, 0.7, -0.3)


def run(axis: str, amplitude: float = 0.05, phase: float = 0.0) -> SweepRun:
    return SweepRun(axis, POSE, 0.0, ((1.0, amplitude, phase), (2.0, amplitude, 2 * phase)), 1.0, 1, 0.5, 0.25)


def without_spring(scenario: Scenario) -> Scenario:
    """Rigid trains that know viscous friction only, so that the equations of motion hold to the last digit."""
    axes = {
        joint: axis.model_copy(
            update={
                "train": axis.train.model_copy(
                    update={
                        "spring": None,
                        "cogging": (),
                        "motor_friction": Friction(viscous=axis.train.motor_friction.viscous),
                        "load_friction": Friction(),
                    }
                )
            }
        )
        for joint, axis in scenario.axes.items()
    }
    return scenario.model_copy(update={"axes": axes})


def test_one_axis_alone_runs_as_in_a_sweep(noise_free: Load) -> None:
    sweep = replace(run("joint_3"), offset_velocity=0.02)
    (alone,) = run_sweeps(noise_free("six"), [sweep], seed=1)
    ((coupled,),) = run_trajectories(noise_free("six"), [[sweep]], seed=1)
    for column, values in alone.items():
        np.testing.assert_allclose(coupled[column], values, rtol=1e-6, atol=1e-6, err_msg=column)


def test_all_axes_move_by_the_equations_of_motion(noise_free: Load) -> None:
    scenario = without_spring(noise_free("six"))
    sweeps = [run(joint, 0.1, 0.4 + number) for number, joint in enumerate(scenario.joints)]
    (columns,) = run_trajectories(scenario, [sweeps], seed=1)
    position, velocity, effort = (
        np.stack([c[name] for c in columns], -1) for name in ("position", "velocity", "effort")
    )
    acceleration = np.gradient(velocity, 1e-3, axis=0)
    model = pin.buildModelFromXML(real_urdf(scenario))
    data = model.createData()
    trains = [scenario.driven(joint).train for joint in scenario.joints]
    motor = [
        t.motor_inertia * scenario.nominal(j).gear_ratio ** 2 for t, j in zip(trains, scenario.joints, strict=True)
    ]
    viscous = np.array([train.motor_friction.viscous for train in trains])
    rated = np.array([scenario.nominal(joint).rated_effort for joint in scenario.joints])
    for k in range(800, 1700, 90):  # the window: no corner of the set-point within reach of the difference quotient
        torque = pin.rnea(model, data, position[k], velocity[k], acceleration[k])
        expected = torque + motor * acceleration[k] + viscous * velocity[k]
        np.testing.assert_array_less(np.abs(effort[k] - expected) / rated, 3e-5)


def test_a_standing_robot_rests_on_its_holding_torque(noise_free: Load) -> None:
    trains = CoupledTrains(noise_free("six"), STEP)
    trains.stand(np.array(POSE))
    effort = np.array([trains.settle(row) for row in range(6)])
    effort = np.array([trains.settle(row) for row in range(6)])  # every load has sagged by now
    trains.free[:] = 1.0
    start = trains.position.copy()
    for _ in range(400):
        trains.step(effort)
    np.testing.assert_allclose(trains.position, start, atol=1e-6)


def test_dry_friction_holds_an_axis_that_another_shakes(noise_free: Load) -> None:
    # joint 6 has no set-point: what joint 5 does to it stays below its friction, so it does not move at all
    six = noise_free("six")
    shaken, still = run("joint_5", 0.05), replace(run("joint_6"), sines=())
    ((moved, stuck),) = run_trajectories(six, [[shaken, still]], seed=1)
    assert np.ptp(moved["position"]) > 5e-3
    assert np.ptp(stuck["position"]) < 2e-6


def test_sweeps_that_are_no_trajectory_are_refused(noise_free: Load) -> None:
    six = noise_free("six")
    for sweeps, text in (
        ([], "at least one"),
        ([run("joint_1"), run("joint_1")], "twice"),
        ([run("joint_1"), replace(run("joint_2"), periods=2)], "joint_2"),
        ([run("joint_1"), replace(run("joint_2"), pose=(0.0,) * 6)], "joint_2"),
        ([replace(run("joint_1"), pose=(0.0, 0.0))], "2 positions"),
        ([replace(run("joint_1"), sample_rate=300.0)], "300"),
    ):
        with pytest.raises(ScenarioError, match=text):
            run_trajectories(six, [sweeps], seed=1)
    with pytest.raises(ScenarioError, match="cannot move"):
        run_trajectories(noise_free("full"), [[run("joint_4")]], seed=1)


def test_the_live_machine_couples_its_axes(noise_free: Load) -> None:
    setpoints = np.zeros((600, 6))
    setpoints[:, 2] = 0.1 * np.sin(np.pi * np.arange(600) / 600) ** 2
    effort = {}
    for energised in (("joint_3",), ("joint_2", "joint_3")):
        machine = Machine(without_spring(noise_free("six")), seed=1)
        for joint in energised:
            machine.energise(joint, True)
        effort[energised] = machine.advance(setpoints).effort[:, 1:3]
    alone, both = effort.values()
    assert not alone[:, 0].any()
    assert np.ptp(both[:, 0]) > 50  # the forearm's swing has to be held against by the upper arm's drive
    np.testing.assert_allclose(both[:, 1], alone[:, 1], atol=20)
