"""Sweeps of the plant: columns, seeds, batches, rates, noise; axes that feel each other; replay."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from simulator import (
    DriveTrain,
    Friction,
    Measurement,
    Motion,
    MovingAxis,
    NoiseRun,
    Scenario,
    ScenarioError,
    SweepRun,
    replay,
    run_sweeps,
    run_trajectories,
    true_inertia,
)
from simulator.machine import LiveMachine
from simulator.plant import Plant
from simulator.rigid_body import RigidBody, moving_axis, real_urdf
from tests.unit.simulator.conftest import line

pytestmark = pytest.mark.slow

Make = Callable[..., SweepRun]
Load = Callable[[str], Scenario]


def test_the_seed_decides_and_repeats_differ(scenario: Load, sweep: Make) -> None:
    twice = [sweep("joint_3"), sweep("joint_3")]
    one, again = run_sweeps(scenario("full"), twice, seed=7), run_sweeps(scenario("full"), twice, seed=7)
    np.testing.assert_array_equal(one[1]["effort"], again[1]["effort"])
    assert np.any(one[0]["effort"] != one[1]["effort"])
    other = run_sweeps(scenario("full"), twice, seed=8)
    assert np.any(one[0]["effort"] != other[0]["effort"])


@pytest.mark.parametrize("name", ["rigid", "full", "misfit"])
def test_a_run_alone_equals_the_same_run_in_a_batch(noise_free: Load, sweep: Make, name: str) -> None:
    wanted = [sweep("joint_2", q2=-0.4, periods=1), noise(periods=1)]
    others = [sweep("joint_1"), sweep("joint_3", offset=-0.02), *wanted, sweep("joint_2", q2=1.0)]
    together = run_sweeps(noise_free(name), others, seed=1)[2:4]
    assert ["excitation_effort" in columns for columns in together] == [False, True]
    for run, columns in zip(wanted, together, strict=True):
        (alone,) = run_sweeps(noise_free(name), [run], seed=1)
        for column, values in alone.items():
            np.testing.assert_allclose(columns[column], values, rtol=1e-10, atol=1e-12, err_msg=column)


def test_a_lower_rate_keeps_the_ratio_of_torque_and_speed(noise_free: Load, sweep: Make) -> None:
    runs = [sweep("joint_1", sample_rate=rate) for rate in (1000.0, 250.0)]
    fast, slow = run_sweeps(noise_free("rigid"), runs, seed=1)
    np.testing.assert_allclose(slow["time"], np.arange(1000) / 250)
    for frequency in (2.0, 5.0):
        ratios = [
            line(columns, "effort", frequency, run) / line(columns, "velocity", frequency, run)
            for columns, run in zip((fast, slow), runs, strict=True)
        ]
        assert ratios[1] == pytest.approx(ratios[0], rel=2e-5)


def test_cogging_appears_at_its_order(noise_free: Load) -> None:
    # 24 periods a motor revolution, 171 motor revolutions a joint revolution: 7 Hz at this speed, sines left out
    speed = 2 * np.pi * 7.0 / (24 * 171.0)
    run = SweepRun("joint_1", (0.0, 0.4, -0.9, 0.0, 0.0, 0.0), speed, (), 1.0, 3, 0.5, 1.5)
    (columns,) = run_sweeps(noise_free("full"), [run], seed=1)
    lines = {f: abs(line(columns, "effort", f, run)) for f in (3.0, 5.0, 7.0, 9.0, 11.0, 14.0)}
    assert min(lines[7.0], lines[14.0]) > 1.0
    assert max(lines[3.0], lines[5.0], lines[9.0], lines[11.0]) < 0.05


def test_sweeps_that_do_not_fit_are_refused(scenario: Load, sweep: Make) -> None:
    full = scenario("full")
    for refused, text in (
        (sweep("joint_4"), "joint_4"),
        (sweep("joint_1", sample_rate=300.0), "300"),
        (SweepRun("joint_1", (0.0, 0.0), 0.01, (), 1.0, 1, 0.5, 0.5), "2 positions"),
    ):
        with pytest.raises(ScenarioError, match=text):
            run_sweeps(full, [refused], seed=1)
    assert run_sweeps(full, [], seed=1) == []


def noise(axis: str = "joint_1", **changes: object) -> NoiseRun:
    """1 % of rated torque from 1 to 40 Hz, four periods of 2 s."""
    fields: dict[str, object] = {
        "axis": axis,
        "pose": (0.1, 0.4, -0.9, 0.0, 0.0, 0.0),
        "offset_velocity": 0.0105,
        "effort": 30.0,
        "lowest": 1.0,
        "highest": 40.0,
        "period": 2.0,
        "periods": 4,
        "seed": 5,
        "softening": 0.5,
        "ramp": 0.5,
        "settle": 3.0,
    }
    return NoiseRun(**(fields | changes))  # pyright: ignore[reportArgumentType]


def spectrum(columns: dict[str, np.ndarray], name: str, run: NoiseRun) -> np.ndarray:
    """Complex amplitudes at every multiple of 1/period, mean over the periods of the window."""
    start, count = round(run.waveform.measure_from * 1000), round(run.period * 1000)
    periods = columns[name][start : start + count * run.periods].reshape(run.periods, count)
    return 2 * np.fft.rfft(periods.mean(axis=0)) / count


@pytest.mark.slow
def test_injected_torque_is_the_wanted_noise(noise_free: Load) -> None:
    run = noise()
    (columns,) = run_sweeps(noise_free("full"), [run], seed=1)
    injected = columns["excitation_effort"]
    window = injected[3500:11500]
    assert np.std(window) == pytest.approx(30.0, rel=0.01)
    np.testing.assert_allclose(window[:2000], window[2000:4000], atol=1e-9)
    lines = np.abs(spectrum(columns, "excitation_effort", run))
    amplitude = 30.0 * np.sqrt(2 / 79)
    np.testing.assert_allclose(lines[2:81], amplitude, rtol=0.02)  # the cycle's mean takes 0.5 % at 40 Hz
    assert max(lines[:2].max(), lines[81:200].max()) < 1e-3 * amplitude
    assert abs(injected[0]) < 0.1
    assert abs(injected[-1]) < 0.1
    other = run_sweeps(noise_free("full"), [noise(seed=6)], seed=1)[0]["excitation_effort"]
    assert np.corrcoef(other[3500:11500], window)[0, 1] < 0.3


def test_injected_torque_moves_the_plant_as_its_physics_say(noise_free: Load) -> None:
    """Effort over velocity at the excited lines is i w J + mu, whatever the controller does."""
    rigid = noise_free("rigid")
    run = noise()
    (columns,) = run_sweeps(rigid, [run], seed=1)
    lines = np.arange(2, 81)
    impedance = spectrum(columns, "effort", run)[lines] / spectrum(columns, "velocity", run)[lines]
    inertia = impedance.imag / (2 * np.pi * lines / run.period)
    (truth,) = true_inertia(rigid, "joint_1", [run.pose])
    np.testing.assert_allclose(inertia, truth, rtol=0.01)
    # the controller's part: effort = excitation - C * velocity, with the softened PI
    control = rigid.driven("joint_1").control
    laplace = 2j * np.pi * lines / run.period
    pi = control.gain * 0.5 * (1 + 0.5 / (control.reset_time * laplace))
    wanted = spectrum(columns, "excitation_effort", run) - spectrum(columns, "effort", run)
    np.testing.assert_allclose(wanted[lines] / spectrum(columns, "velocity", run)[lines] / pi, 1.0, atol=0.05)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"softening": 0.0}, "softening 0.0"),
        ({"softening": 1.5}, "softening 1.5"),
        ({"period": 2.0003}, "period 2.0003 s is not a multiple of 0.001 s"),
        ({"lowest": 3.1, "highest": 3.4}, "no line"),
        ({"highest": 500.0}, "above the rate"),
    ],
)
def test_noise_that_cannot_be_is_refused(scenario: Load, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        run_sweeps(scenario("full"), [noise(**changes)], seed=1)


POSE = (0.2, 0.3, -0.6, 0.4, 0.7, -0.3)


def run(axis: str, amplitude: float = 0.05, phase: float = 0.0) -> SweepRun:
    return SweepRun(axis, POSE, 0.0, ((1.0, amplitude, phase), (2.0, amplitude, 2 * phase)), 1.0, 1, 0.5, 0.25)


def without_spring(scenario: Scenario) -> Scenario:
    """Rigid trains that know viscous friction only, so that the equations of motion hold to the last digit."""
    axes = {}
    for joint, axis in scenario.axes.items():
        viscous = Friction(viscous=axis.train.motor_friction.viscous)
        bare = {"spring": None, "cogging": (), "motor_friction": viscous, "load_friction": Friction()}
        axes[joint] = axis.model_copy(update={"train": axis.train.model_copy(update=bare)})
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
        machine = LiveMachine(without_spring(noise_free("six")), seed=1)
        for joint in energised:
            machine.energise(joint, True)
        effort[energised] = machine.advance(setpoints).effort[:, 1:3]
    alone, both = effort.values()
    assert not alone[:, 0].any()
    assert np.ptp(both[:, 0]) > 50  # the forearm's swing has to be held against by the upper arm's drive
    np.testing.assert_allclose(both[:, 1], alone[:, 1], atol=20)


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


def inside_of(run: SweepRun, time: np.ndarray) -> np.ndarray:
    start = run.waveform.measure_from
    return (time >= start) & (time < start + run.period * run.periods)


@pytest.mark.parametrize(("name", "rms"), [("rigid", 1e-3), ("full", 0.06), ("misfit", 0.06)])
def test_replay_reproduces_the_torque(noise_free: Load, sweep: Make, name: str, rms: float) -> None:
    scenario = noise_free(name)
    body = RigidBody(scenario)
    runs = [sweep(f"joint_{k}", sample_rate=rate, periods=k) for k in (1, 2, 3) for rate in (1000.0, 250.0)]
    recorded = run_sweeps(scenario, runs, seed=1)
    axes = [moving_axis(scenario, body, run.axis, run.pose) for run in runs]
    motions = [Motion(columns["time"], columns["position"], columns["velocity"]) for columns in recorded]
    for run, columns, effort in zip(runs, recorded, replay(axes, motions), strict=True):
        inside = inside_of(run, columns["time"])
        assert columns["effort"][inside].std() > 5.0
        assert np.sqrt(np.mean((effort - columns["effort"])[inside] ** 2)) < rms


@pytest.mark.slow
@pytest.mark.parametrize("elastic", [False, True])
def test_replay_knows_every_effect(noise_free: Load, sweep: Make, elastic: bool) -> None:
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
    inside = inside_of(run, time)
    for row, effort in enumerate(replay(axes, motions, measurement)):
        gap = np.sqrt(np.mean((effort - samples.effort[:, row])[inside] ** 2))
        assert gap < 0.12, trains[row]


def test_a_warm_gear_is_replayed_warm(noise_free: Load, sweep: Make) -> None:
    scenario, run = noise_free("rigid"), sweep("joint_2", periods=1)
    cold = moving_axis(scenario, RigidBody(scenario), "joint_2", run.pose)
    warming = {"heat_capacity": 1e6, "time_constant": 1e6, "coulomb_loss": 0.1}
    train = DriveTrain.model_validate(cold.train.model_dump() | {"warming": warming})
    (columns,) = run_sweeps(scenario, [run], seed=1)
    motion = Motion(columns["time"], columns["position"], columns["velocity"])
    rows: list[MovingAxis] = [replace(cold, train=train), replace(cold, train=train, warmth=2.0)]
    inside = inside_of(run, columns["time"])
    first, second = replay(rows, [motion] * 2)
    np.testing.assert_allclose((first - second)[inside], 155.0 * (1 - np.exp(-0.2)), rtol=1e-4)


def test_each_row_has_its_own_channels(noise_free: Load, sweep: Make) -> None:
    """Torque told late, and speed told late, which is torque that comes early."""
    scenario, run = noise_free("rigid"), sweep("joint_2", periods=1)
    axis = moving_axis(scenario, RigidBody(scenario), "joint_2", run.pose)
    (columns,) = run_sweeps(scenario, [run], seed=1)
    time, inside = columns["time"], inside_of(run, columns["time"])
    motion = Motion(time, columns["position"], columns["velocity"])
    late = [Measurement(), Measurement(effort_delay=0.003), Measurement(velocity_delay=0.003)]
    exact, effort, speed = replay([axis] * 3, [motion] * 3, late)
    np.testing.assert_allclose(effort[inside], np.interp(time - 0.003, time, exact)[inside], atol=0.05)
    early = np.interp(time + 0.003, time, exact)[inside]
    # the position was told in time, and with it the weight
    np.testing.assert_allclose(speed[inside], early, atol=0.003 * 0.025 * 3500.0)
    assert np.abs(exact[inside] - early).max() > 2.0
    assert replay([], []) == []
    with pytest.raises(ValueError, match="1 axes for 2 motions"):
        replay([axis], [motion, motion])
