"""A sweep: its set-point as velocity and positions, by hand and in closed form; its limits, with value and unit."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from drivers.canopen.profile import Codec
from drivers.canopen.streamed_axis import Positions, Velocities
from drivers.cia402.checks import DriveEnvelope, check_move, check_sweep, envelope, set_point, travel
from drivers.errors import LimitExceeded, distinct
from drivers.ports import SineCommand, SweepCommand, SweepMode
from tests.unit.drivers.given import axis, sweep


def command(*sines: SineCommand, offset: float = 0.1) -> SweepCommand:
    return replace(sweep(), sines=sines, offset_velocity=offset, ramp=0.5, settle=0.25)


def test_envelope_by_hand() -> None:
    when = np.array([-1.0, 0.0, 0.125, 0.25, 0.5, 1.0, 2.75, 3.0, 3.25, 4.0])
    quarter = 0.5 - 0.5 * math.cos(math.pi / 4)
    assert envelope(command(), when) == pytest.approx([0, 0, quarter, 0.5, 1, 1, 1, 0.5, 0, 0])


def test_phase_counts_from_the_window() -> None:
    sweep = command(SineCommand(2.0, 0.03, 0.0), SineCommand(5.0, 0.01, math.pi / 2))
    # t0 = 0.75 s; an eighth of a second later the 2 Hz sine is at its peak, the 5 Hz one at 90 + 225 degrees
    value = set_point(sweep, np.array([0.75, 0.875, 1.0]))
    root = math.sqrt(0.5)
    assert value == pytest.approx([0.1 + 0.01, 0.1 + 0.03 - 0.01 * root, 0.1])


def test_travel_by_hand() -> None:
    # ramps of raised cosine count half: 0.1 (0.25 + 0.25 + 2 + 0.25)
    assert travel(command()) == pytest.approx((0.0, 0.275), abs=1e-6)
    assert travel(command(offset=-0.1)) == pytest.approx((-0.275, 0.0), abs=1e-6)


PERIOD, LAST, START = 0.008, 150, 5000  # s, cycles, increments
CODEC = Codec(100.0, 0.25, 10.0, increments=1e6, velocity_unit=1e-3 / 60)
STEP = 2 * np.pi / (100.0 * 1e6)  # rad, one increment


def slow(**changes: Any) -> SweepCommand:
    slow = {
        "offset_velocity": 0.05,
        "sines": (SineCommand(5.0, 0.02, 0.3),),
        "period": 0.4,
        "ramp": 0.15,
        "settle": 0.1,
    }
    return sweep(**(slow | changes))


def positions(**changes: Any) -> Positions:
    return Positions(CODEC, slow(**changes), LAST, PERIOD, START, mode_bits=0x10)


def test_positions_are_the_integral_of_the_velocities() -> None:
    sent, plain = positions(), positions(sines=())
    travelled = np.array([sent.planned(k) - START for k in range(LAST)]) * STEP
    # the ramps of the offset are raised cosines: half of it each; the sine turns through whole periods
    assert plain.planned(LAST) == pytest.approx(START + 0.05 * (0.15 + 0.1 + 0.8) / STEP, abs=2)
    fine = np.linspace(0.0, LAST * PERIOD, LAST * 400 + 1)
    wave = set_point(slow(), fine)
    exact = np.concatenate([[0.0], np.cumsum((wave[1:] + wave[:-1]) / 2 * np.diff(fine))])[400::400]
    assert travelled == pytest.approx(exact, abs=2e-6)


def test_what_is_sent_is_where_the_axis_shall_be_one_cycle_later() -> None:
    sent = positions()
    assert sent.planned(0) > START  # before SYNC 0, and reached at SYNC 1
    assert sent.planned(LAST) == sent.planned(LAST + 1000) == sent.planned(LAST - 1)


def test_a_ramp_goes_on_from_the_place_sent_last_and_ends_where_it_comes_to_rest() -> None:
    sent = positions()
    speed = sent.velocity(59)
    assert speed == Velocities(CODEC, slow(), LAST, PERIOD).planned(59)
    one_cycle = speed * CODEC.velocity_unit * PERIOD * CODEC.increments
    assert sent.ramped(60, speed) == pytest.approx(sent.planned(59) + one_cycle, abs=1)
    resting = sent.ramped(61, 0)
    assert resting == pytest.approx(sent.planned(59) + one_cycle, abs=1)
    assert sent.ramped(62, 0) == resting  # never a jump to anywhere else


def test_a_gear_that_turns_the_other_way_turns_the_positions() -> None:
    codec = Codec(-100.0, 0.25, 10.0, increments=1e6, velocity_unit=1e-3 / 60)
    turned = Positions(codec, slow(), LAST, PERIOD, START, 0)
    straight = positions()
    assert turned.planned(80) - START == pytest.approx(START - straight.planned(80), abs=1)
    assert turned.ramped(81, -1000) - turned.planned(80) == pytest.approx(-1000 / 60e3 * PERIOD * 1e6, abs=1)


def test_a_position_beyond_32_bits_is_refused_before_anything_moves() -> None:
    with pytest.raises(LimitExceeded, match=r"position .* does not fit 32 bits"):
        Positions(CODEC, slow(), LAST, PERIOD, 2**31 - 1000, 0)


ENVELOPE = DriveEnvelope(0.1, 200.0, (-1.0, 1.0), "rad", "N m")

AXIS = axis(gear_ratio=-100.0, position_limits=(-2.0, 2.0), velocity_limit=0.5)

SWEEP = sweep(
    SineCommand(2.0, 0.02, 0.0),
    offset_velocity=0.05,
    periods=5,
    ramp=0.5,
    settle=0.5,
    velocity_limit=0.1,
    effort_limit=500.0,
)


@pytest.mark.parametrize(
    ("reading", "message"),
    [
        ((1.5, 0.0, 0.0), "position 1.5 rad is outside -1 to 1 rad"),
        ((-1.5, 0.0, 0.0), "position -1.5 rad is outside -1 to 1 rad"),
        ((0.0, -0.2, 0.0), "velocity -0.2 rad/s is beyond 0.1 rad/s"),
        ((0.0, 0.0, 300.0), "effort 300 N m is beyond 200 N m"),
        ((math.nan, 0.0, 0.0), "position nan rad is outside -1 to 1 rad"),
        ((0.0, math.nan, 0.0), "velocity nan rad/s is beyond 0.1 rad/s"),
        ((0.0, 0.0, math.nan), "effort nan N m is beyond 200 N m"),
    ],
)
def test_a_reading_outside_the_envelope_is_told(reading: tuple[float, float, float], message: str) -> None:
    violation = ENVELOPE.violation(*reading)
    assert violation is not None
    assert violation[0] == message


def test_a_reading_on_the_limits_is_inside() -> None:
    assert ENVELOPE.violation(1.0, -0.1, 200.0) is None


def test_moves() -> None:
    check_move(AXIS, -2.0, 0.5)
    with pytest.raises(LimitExceeded, match=r"joint_1: target position 2.1 rad is outside -2 to 2 rad"):
        check_move(AXIS, 2.1, 0.1)
    with pytest.raises(LimitExceeded, match=r"joint_1: velocity 0.6 rad/s must be above 0 and at most 0.5 rad/s"):
        check_move(AXIS, 1.0, 0.6)


@pytest.mark.parametrize(
    ("change", "start", "message"),
    [
        ({"velocity_limit": 0.06}, 0.0, "peak velocity 0.07 rad/s is beyond the limit of 0.06 rad/s"),
        ({"sines": (SineCommand(2.0, math.nan, 0.0),)}, 0.0, "peak velocity nan rad/s"),
        ({"sines": (SineCommand(126.0, 0.001, 0.0),)}, 0.0, "126 Hz is not below half the sample rate of 250 Hz"),
        ({"sines": (SineCommand(1.0, 0.001, 0.0),) * 17}, 0.0, "17 sines are more than the drive's 16"),
        ({}, 0.3, "highest position .* rad of the sweep is outside its window -0.5 to 0.5 rad"),
        ({"offset_velocity": -0.05}, -0.3, "lowest position"),
        ({}, -0.6, "start -0.6 rad"),
        ({"position_window": (-0.5, 2.5)}, 0.0, "window -0.5 to 2.5 rad is outside -2 to 2 rad"),
        ({"settle": -1.0}, 0.0, "settle -1.0 s"),
        ({"period": math.inf}, 0.0, "period inf"),
        ({"periods": 0}, 0.0, "settle 0.5 s must be 0 or more, periods 0 must be 1 or more"),
    ],
)
def test_sweeps_that_are_refused(change: dict[str, object], start: float, message: str) -> None:
    with pytest.raises(LimitExceeded, match=f"joint_1: {message}"):
        check_sweep(AXIS, replace(SWEEP, **change), start, 0.004)


def test_more_sines_than_the_drive_takes_can_be_streamed() -> None:
    many = replace(SWEEP, mode=SweepMode.HOST_STREAMED, sines=(SineCommand(1.0, 0.001, 0.0),) * 17)
    check_sweep(AXIS, many, 0.0, 0.004)


@given(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6))
def test_a_value_is_told_from_a_limit_that_it_differs_from(value: float, limit: float) -> None:
    shown, most = distinct(value, limit)
    assert (shown == most) == (value == limit) or {value, limit} == {0.0, -0.0}
    assert float(shown) == pytest.approx(value, rel=1e-4)


def test_an_axis_just_short_of_its_target_is_told_by_how_much() -> None:
    assert distinct(-0.53232, -0.53232 + 4e-8) == ("-0.53232", "-0.53231996")
    assert distinct(0.5, 0.25, 0.75) == ("0.5", "0.25", "0.75")
