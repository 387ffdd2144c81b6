import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.identification.design.excitation import LINES, design_sweep, velocity_setpoint
from service.model.errors import BadInput
from service.model.robot import Axis, Robot, RobotDescription, build_robot
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
    assert set(lines) < set(LINES)
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
