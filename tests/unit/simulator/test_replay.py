"""Replay gives back the torque of the closed loop from the motor's motion alone, whatever the drive train hides."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from simulator import DriveTrain, Measurement, Motion, MovingAxis, Scenario, SweepRun, replay, run_sweeps
from simulator.moving_axis import moving_axis
from simulator.plant import Plant
from simulator.rigid_body import RigidBody

pytestmark = pytest.mark.slow

EFFECTS: list[dict[str, object]] = [
    {"motor_friction": {"viscous": 140.0, "coulomb": 90.0, "backward_viscous": 100.0, "backward_coulomb": 60.0}},
    {"load_friction": {"viscous": 60.0, "coulomb": 40.0, "backward_coulomb": 70.0}},
    {"motor_friction": {"coulomb": 90.0, "stribeck": {"extra": 40.0, "velocity": 0.008, "exponent": 1.4}}},
    {"motor_friction": {"coulomb": 90.0, "power": {"coefficient": 200.0, "exponent": 0.5}}},
    {"motor_friction": {"coulomb": 90.0, "load_dependence": 0.05}},
    {"load_friction": {"coulomb": 40.0, "patch": {"centre": 0.41, "width": 0.02, "coulomb": 30.0}}},
    {"warming": {"heat_capacity": 3.0, "time_constant": 20.0, "coulomb_loss": 0.2, "viscous_loss": 0.1}},
    {"hose": {"stiffness": 1500.0, "rest": 0.2, "damping": 200.0}},
    {"appendage": {"inertia": 12.0, "stiffness": 2e4, "damping": 40.0}},
    {"cogging": [{"order": 24, "amplitude": 15.0}, {"order": 48, "amplitude": 6.0, "phase": 1.0}]},
    {"effort_gain": 1.05, "effort_offset": -20.0},
]
ELASTIC: list[dict[str, object]] = [
    {"spring": {"stiffness": 1.75e6, "damping": 1400.0, "hardening": 2e10}},
    {"spring": {"stiffness": 1.75e6, "damping": 1400.0, "backlash": 3e-4}},
    {
        "spring": {"stiffness": 1.75e6, "damping": 1400.0},
        "gear_error": [{"order": 1, "amplitude": 3e-5}, {"order": 2, "amplitude": 1e-5, "phase": 2.0}],
    },
]


def window(run: SweepRun, time: np.ndarray) -> np.ndarray:
    start = run.waveform.measure_from
    return (time >= start) & (time < start + run.period * run.periods)


@pytest.mark.parametrize(("name", "rms"), [("rigid", 1e-3), ("full", 0.06), ("misfit", 0.06)])
def test_replay_reproduces_the_torque(
    noise_free: Callable[[str], Scenario], sweep: Callable[..., SweepRun], name: str, rms: float
) -> None:
    scenario = noise_free(name)
    body = RigidBody(scenario)
    runs = [sweep(f"joint_{k}", sample_rate=rate, periods=k) for k in (1, 2, 3) for rate in (1000.0, 250.0)]
    recorded = run_sweeps(scenario, runs, seed=1)
    axes = [moving_axis(scenario, body, run.axis, run.pose) for run in runs]
    motions = [Motion(columns["time"], columns["position"], columns["velocity"]) for columns in recorded]
    for run, columns, effort in zip(runs, recorded, replay(axes, motions), strict=True):
        inside = window(run, columns["time"])
        assert columns["effort"][inside].std() > 5.0
        assert np.sqrt(np.mean((effort - columns["effort"])[inside] ** 2)) < rms


@pytest.mark.slow
@pytest.mark.parametrize("elastic", [False, True])
def test_replay_knows_every_effect(
    noise_free: Callable[[str], Scenario], sweep: Callable[..., SweepRun], elastic: bool
) -> None:
    """One row of the plant for each effect, weight and noise-free record; the effect alone would be far more."""
    scenario, run = noise_free("full" if elastic else "rigid"), sweep("joint_2", periods=1)
    axis = moving_axis(scenario, RigidBody(scenario), "joint_2", run.pose)
    trains = [axis.train.model_dump() | effect for effect in (EFFECTS + ELASTIC if elastic else EFFECTS)]
    axes = [replace(axis, train=DriveTrain.model_validate(train), warmth=0.5) for train in trains]
    measurement = Measurement(effort_delay=0.0006, effort_smoothing=0.0004)
    plant = Plant(axes, [scenario.driven("joint_2").control] * len(axes), measurement)
    plant.trains.position[:] = run.pose[1]
    for row in range(len(axes)):
        plant.release(row)
    time = np.arange(round(run.waveform.duration * 1000)) / 1000
    setpoints = np.tile(run.waveform.velocity(time + 1e-3)[:, None], (1, len(axes)))
    samples = plant.advance(setpoints)
    motions = [Motion(time, samples.position[:, row], samples.velocity[:, row]) for row in range(len(axes))]
    inside = window(run, time)
    for row, effort in enumerate(replay(axes, motions, measurement)):
        gap = np.sqrt(np.mean((effort - samples.effort[:, row])[inside] ** 2))
        assert gap < 0.12, trains[row]


def test_a_warm_gear_is_replayed_warm(noise_free: Callable[[str], Scenario], sweep: Callable[..., SweepRun]) -> None:
    scenario, run = noise_free("rigid"), sweep("joint_2", periods=1)
    cold = moving_axis(scenario, RigidBody(scenario), "joint_2", run.pose)
    warming = {"heat_capacity": 1e6, "time_constant": 1e6, "coulomb_loss": 0.1}
    train = DriveTrain.model_validate(cold.train.model_dump() | {"warming": warming})
    (columns,) = run_sweeps(scenario, [run], seed=1)
    motion = Motion(columns["time"], columns["position"], columns["velocity"])
    rows: list[MovingAxis] = [replace(cold, train=train), replace(cold, train=train, warmth=2.0)]
    inside = window(run, columns["time"])
    first, second = replay(rows, [motion] * 2)
    np.testing.assert_allclose((first - second)[inside], 155.0 * (1 - np.exp(-0.2)), rtol=1e-4)


def test_each_row_has_its_own_channels(noise_free: Callable[[str], Scenario], sweep: Callable[..., SweepRun]) -> None:
    """Torque told late, and speed told late, which is torque that comes early."""
    scenario, run = noise_free("rigid"), sweep("joint_2", periods=1)
    axis = moving_axis(scenario, RigidBody(scenario), "joint_2", run.pose)
    (columns,) = run_sweeps(scenario, [run], seed=1)
    time, inside = columns["time"], window(run, columns["time"])
    motion = Motion(time, columns["position"], columns["velocity"])
    late = [Measurement(), Measurement(effort_delay=0.003), Measurement(velocity_delay=0.003)]
    exact, effort, speed = replay([axis] * 3, [motion] * 3, late)
    np.testing.assert_allclose(effort[inside], np.interp(time - 0.003, time, exact)[inside], atol=0.05)
    early = np.interp(time + 0.003, time, exact)[inside]
    # the position was told in time, and with it the weight
    np.testing.assert_allclose(speed[inside], early, atol=0.003 * 0.025 * 3500.0)
    assert np.abs(exact[inside] - early).max() > 2.0
    with pytest.raises(ValueError, match="1 axes for 2 motions"):
        replay([axis], [motion, motion])


def test_nothing_in_nothing_out() -> None:
    assert replay([], []) == []
