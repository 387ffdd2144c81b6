from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st

from service import BadInput
from service.identification.design.excitation import (
    Excitation,
    Sines,
    design_sweep,
    peak_jerk,
    velocity_setpoint,
    way,
    zippered_lines,
)
from service.model import Axis, Robot, RobotDescription, Sine, build_robot
from tests.random_chain import random_arm
from tests.unit.service.identification.conftest import URDF

POSE = np.zeros(2)


def test_a_sweep_stays_within_its_travel_and_ends_at_rest(robot: Robot) -> None:
    sweep = design_sweep(robot, "swing", POSE, load_inertia=300.0, locked_rotor_frequency=8.0)
    time = np.linspace(0, sweep.duration, 200_001)
    velocity = velocity_setpoint(sweep, time)
    assert velocity[0] == velocity[-1] == 0.0
    way = np.concatenate([[0.0], np.cumsum((velocity[1:] + velocity[:-1]) / 2 * np.diff(time))])
    assert way[-1] == pytest.approx(sweep.travel, abs=2e-4)  # the faded-in sines leave a trace
    assert np.abs(way).max() < np.radians(4.0)


@pytest.mark.slow
@given(
    gear=st.floats(60, 300),
    orders=st.lists(st.integers(2, 60), min_size=1, max_size=2).map(tuple),
    direction=st.sampled_from([1, -1]),
)
def test_cogging_falls_between_the_lines(gear: float, orders: tuple[int, ...], direction: int) -> None:
    axes = tuple(
        Axis(joint=joint, gear_ratio=gear, rated_effort=3000.0, cogging_orders=orders) for joint in ("swing", "lift")
    )
    robot = build_robot(RobotDescription(name="pair", urdf="robot.urdf", axes=axes), URDF)
    try:
        sweep = design_sweep(robot, "swing", POSE, load_inertia=300.0, direction=direction)
    except BadInput:
        return  # no offset within the travel keeps these orders off the lines: refused, not bent
    assert np.sign(sweep.offset_velocity) == direction
    for order in orders:
        cycles = order * gear * abs(sweep.offset_velocity) / (2 * np.pi) * sweep.periods
        assert cycles == pytest.approx(round(cycles), abs=1e-6)  # whole cycles in the window: orthogonal
        assert round(cycles) % sweep.periods  # and never on a whole Hz


def test_neither_motor_nor_load_reverses(robot: Robot) -> None:
    resonance = 6.0
    sweep = design_sweep(robot, "swing", POSE, load_inertia=300.0, locked_rotor_frequency=resonance)
    lines = np.array([sine.frequency for sine in sweep.sines])
    amplitudes = np.array([sine.amplitude for sine in sweep.sines])
    assert set(lines) < set(Sines.lines)
    assert lines.max() <= 0.75 * resonance
    load_gain = 1 / (1 - (lines / resonance) ** 2)
    assert np.sum(amplitudes * load_gain) < sweep.offset_velocity


def test_limits_scale_the_sweep_or_refuse_it(robot: Robot) -> None:
    free = design_sweep(robot, "swing", POSE, load_inertia=300.0)
    weak = design_sweep(robot, "swing", POSE, load_inertia=300.0, effort_limit=20.0)
    effort = sum(2 * np.pi * s.frequency * s.amplitude * (300.0 + 57.8) for s in weak.sines)
    assert effort == pytest.approx(20.0)
    assert weak.offset_velocity == free.offset_velocity
    slow = design_sweep(robot, "swing", POSE, load_inertia=300.0, velocity_limit=0.01)
    assert slow.offset_velocity + sum(s.amplitude for s in slow.sines) <= 0.01
    with pytest.raises(BadInput, match="swing: no sweep fits into a travel"):
        design_sweep(robot, "swing", POSE, load_inertia=300.0, travel=1e-4)


@pytest.mark.parametrize("resonance", [0.5, 2.0])
def test_a_resonance_below_the_lines_is_refused(robot: Robot, resonance: float) -> None:
    with pytest.raises(BadInput, match="is not above 2 Hz"):
        design_sweep(robot, "swing", POSE, load_inertia=300.0, locked_rotor_frequency=resonance)


@pytest.mark.parametrize("limit", [0.0, -1.0])
def test_without_effort_for_sines_there_is_no_sweep(robot: Robot, limit: float) -> None:
    with pytest.raises(BadInput, match="leaves no effort for the sines"):
        design_sweep(robot, "swing", POSE, load_inertia=300.0, effort_limit=limit)


def test_an_order_below_one_half_is_no_division_by_zero() -> None:
    axes = tuple(
        Axis(joint=joint, gear_ratio=170.0, rated_effort=3000.0, cogging_orders=(0.4,)) for joint in ("swing", "lift")
    )
    robot = build_robot(RobotDescription(name="pair", urdf="robot.urdf", axes=axes), URDF)
    assert design_sweep(robot, "swing", POSE, load_inertia=300.0).offset_velocity > 0


def test_schroeder_phases_keep_the_crest_low(robot: Robot) -> None:
    sweep = design_sweep(robot, "swing", POSE, load_inertia=300.0)
    time = np.linspace(0, 1, 2000)
    sum_of_sines = sum(s.amplitude * np.sin(2 * np.pi * s.frequency * time + s.phase) for s in sweep.sines)
    assert np.abs(sum_of_sines).max() / np.sqrt(np.mean(sum_of_sines**2)) < 2.4


def numbers(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_nan=False)


SINES = st.builds(Sine, frequency=numbers(0.2, 10.0), amplitude=numbers(0.0, 0.1), phase=numbers(-7.0, 7.0))
SWEEPS = st.builds(
    Excitation,
    offset_velocity=numbers(-0.1, 0.1),
    sines=st.lists(SINES, max_size=5).map(tuple),
    period=numbers(0.1, 2.0),
    periods=st.integers(1, 5),
    ramp=numbers(0.05, 2.0),
    settle=numbers(0.0, 2.0),
)
# a sine with half a turn in the ramp makes a frequency difference of zero
RESONANT = Excitation(0.02, (Sine(frequency=1.0, amplitude=0.01, phase=0.4),), 1.0, 3, 0.5, 0.5)
NODES, WEIGHTS = np.polynomial.legendre.leggauss(24)


def integrated(sweep: Excitation, end: float) -> float:
    """The set-point's integral from 0 to `end` by Gauss-Legendre on short pieces of its three smooth parts."""
    hold = sweep.duration - sweep.ramp
    total = 0.0
    for first, last in ((0.0, sweep.ramp), (sweep.ramp, hold), (hold, sweep.duration)):
        edges = np.linspace(first, max(first, min(last, end)), 40)
        for low, high in pairwise(edges):
            nodes = low + (high - low) * (NODES + 1) / 2
            total += (high - low) / 2 * float(WEIGHTS @ velocity_setpoint(sweep, nodes))
    return total


@settings(deadline=None)
@given(SWEEPS, numbers(0.0, 1.0))
@example(RESONANT, 0.03)
@example(RESONANT, 1.0)
def test_the_path_integrates_the_velocity(sweep: Excitation, part: float) -> None:
    end = part * sweep.duration
    assert abs(way(sweep, np.array([end]))[0] - integrated(sweep, end)) < 1e-12


@settings(deadline=None)
@given(SWEEPS, st.sampled_from([0.001, 0.004, 0.01]))
@example(RESONANT, 0.001)
def test_from_rest_to_rest_it_is_continuous_and_its_steps_are_the_speed(sweep: Excitation, step: float) -> None:
    np.testing.assert_allclose(velocity_setpoint(sweep, np.array([0.0, sweep.duration])), 0.0, atol=1e-14)
    outside = way(sweep, np.array([-1.0, 0.0, sweep.duration, sweep.duration + 1.0]))
    assert (outside[:2] == 0.0).all()
    assert abs(outside[2] - outside[3]) < 1e-15  # the clock's last digit
    time = np.arange(0.0, sweep.duration + step, step)
    path = way(sweep, time)
    peak = abs(sweep.offset_velocity) + sum(sine.amplitude for sine in sweep.sines)
    assert np.abs(np.diff(path)).max() <= peak * step * (1 + 1e-9) + 1e-15
    middle = velocity_setpoint(sweep, time[:-1] + step / 2)
    # where ramp and hold meet, the second derivative jumps within its bound
    assert np.abs(np.diff(path) / step - middle).max() <= peak_jerk(sweep) * step**2 / 24 + 1e-12


def test_whole_turns_cancel() -> None:
    sines = tuple(Sine(frequency=f, amplitude=0.003, phase=f) for f in (2.0, 3.0, 4.0, 5.0))
    sweep = Excitation(0.0162, sines, 1.0, 5, 0.5, 0.5)
    assert abs(way(sweep, np.array([sweep.duration]))[0] - sweep.travel) < 1e-15


@pytest.mark.parametrize("axes", range(2, 7))
def test_lines_of_axes_that_move_at_once_are_no_products_of_each_other(axes: int) -> None:
    window, lines = zippered_lines(axes)
    numbers = [[round(line * window) for line in own] for own in lines]
    every = sorted(number for own in numbers for number in own)
    assert len(set(every)) == len(every)
    assert min(len(own) for own in numbers) >= 2
    assert 2 * window <= every[0]
    assert every[-1] <= 5 * window
    products = {abs(a + sign * b) for a in every for b in every for sign in (-1, 1)} | {3 * a for a in every}
    assert not products & set(every)


def test_other_numbers_of_axes_have_no_simultaneous_sweep() -> None:
    for axes in (1, 7):
        with pytest.raises(BadInput, match="limits 2 and 6"):
            zippered_lines(axes)


def test_a_simultaneous_sweep_turns_no_axis_back_and_keeps_ripple_off_the_lines() -> None:
    r = random_arm(3, 3, rated_effort=300.0, cogging_orders=(6, 12))
    window, lines = zippered_lines(3)
    for joint, own, direction in zip(r.joints, lines, (1, -1, 1), strict=True):
        run = design_sweep(
            r,
            joint,
            np.zeros(3),
            load_inertia=9.0,
            lines=own,
            window=window,
            locked_rotor_frequency=None,
            direction=direction,
        )
        assert (run.period, run.periods, np.sign(run.offset_velocity)) == (window, 1, direction)
        assert sum(sine.amplitude for sine in run.sines) < abs(run.offset_velocity)
        assert abs(run.travel) <= np.radians(4.0)
        for order in (6, 12):
            number = order * 100.0 * abs(run.offset_velocity) * run.period / (2 * np.pi)
            assert number / 2 == pytest.approx(round(number / 2), abs=1e-9)
    with pytest.raises(BadInput, match="no sweep fits"):
        design_sweep(
            r,
            r.joints[0],
            np.zeros(3),
            load_inertia=9.0,
            lines=lines[0],
            window=window,
            locked_rotor_frequency=None,
            travel=1e-6,
        )
