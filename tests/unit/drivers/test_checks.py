"""Limits: what is outside is told with value, limit and unit, and what is not a number is outside."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.cia402.checks import Envelope, check_move, check_sweep
from drivers.errors import LimitExceeded, distinct
from drivers.ports import Sine, SweepMode
from tests.unit.drivers.given import axis, sweep

ENVELOPE = Envelope(0.1, 200.0, (-1.0, 1.0), "rad", "N m")

AXIS = axis(gear_ratio=-100.0, position_limits=(-2.0, 2.0), velocity_limit=0.5)

SWEEP = sweep(
    Sine(2.0, 0.02, 0.0),
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


def test_a_good_sweep_passes() -> None:
    check_sweep(AXIS, SWEEP, 0.0, 0.004)


@pytest.mark.parametrize(
    ("change", "start", "message"),
    [
        ({"velocity_limit": 0.06}, 0.0, "peak velocity 0.07 rad/s is beyond the limit of 0.06 rad/s"),
        ({"sines": (Sine(2.0, math.nan, 0.0),)}, 0.0, "peak velocity nan rad/s"),
        ({"sines": (Sine(126.0, 0.001, 0.0),)}, 0.0, "126 Hz is not below half the sample rate of 250 Hz"),
        ({"sines": (Sine(1.0, 0.001, 0.0),) * 17}, 0.0, "17 sines are more than the drive's 16"),
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
    many = replace(SWEEP, mode=SweepMode.HOST_STREAMED, sines=(Sine(1.0, 0.001, 0.0),) * 17)
    check_sweep(AXIS, many, 0.0, 0.004)


@given(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6))
def test_a_value_is_told_from_a_limit_that_it_differs_from(value: float, limit: float) -> None:
    shown, most = distinct(value, limit)
    assert (shown == most) == (value == limit) or {value, limit} == {0.0, -0.0}
    assert float(shown) == pytest.approx(value, rel=1e-4)


def test_an_axis_just_short_of_its_target_is_told_by_how_much() -> None:
    assert distinct(-0.53232, -0.53232 + 4e-8) == ("-0.53232", "-0.53231996")
    assert distinct(0.5, 0.25, 0.75) == ("0.5", "0.25", "0.75")
