"""A sweep: its set-point as velocity and positions, by hand and in closed form; its limits, with value and unit."""

import math
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, strategies as st

from drivers.canopen.profile import Codec
from drivers.canopen.streamed_axis import Positions, Velocities
from drivers.cia402.checks import DriveEnvelope, check_move, check_noise, check_sweep, envelope, set_point, travel
from drivers.errors import LimitExceeded, distinct
from drivers.ports import ExcitationCommand, NoiseCommand, SineCommand, SweepCommand, SweepMode
from tests.unit.drivers.given import axis, sweep


def command(*sines: SineCommand, offset: float = 0.1) -> SweepCommand:
    return replace(sweep(), sines=sines, offset_velocity=offset, ramp=0.5, settle=0.25)


def test_set_point_by_hand() -> None:
    when = np.array([-1.0, 0.0, 0.125, 0.25, 0.5, 1.0, 2.75, 3.0, 3.25, 4.0])
    quarter = 0.5 - 0.5 * math.cos(math.pi / 4)
    assert envelope(command(), when) == pytest.approx([0, 0, quarter, 0.5, 1, 1, 1, 0.5, 0, 0])
    # t0 = 0.75 s; an eighth of a second later the 2 Hz sine is at its peak, the 5 Hz one at 90 + 225 degrees
    sines = SineCommand(2.0, 0.03, 0.0), SineCommand(5.0, 0.01, math.pi / 2)
    expected = [0.1 + 0.01, 0.1 + 0.03 - 0.01 * math.sqrt(0.5), 0.1]
    assert set_point(command(*sines), np.array([0.75, 0.875, 1.0])) == pytest.approx(expected)
    # ramps of raised cosine count half: 0.1 (0.25 + 0.25 + 2 + 0.25)
    assert travel(command()) == pytest.approx((0.0, 0.275), abs=1e-6)
    assert travel(command(offset=-0.1)) == pytest.approx((-0.275, 0.0), abs=1e-6)


PERIOD, LAST, START = 0.008, 150, 5000  # s, cycles, increments
STEP = 2 * np.pi / (100.0 * 1e6)  # rad, one increment
SLOW = sweep(SineCommand(5.0, 0.02, 0.3), offset_velocity=0.05, period=0.4, ramp=0.15, settle=0.1)


@pytest.mark.parametrize("direction", [1, -1])
def test_positions_are_the_integral_of_the_velocities(direction: int) -> None:
    codec = Codec(100.0 * direction, 0.25, 10.0, increments=1e6, velocity_unit=1e-3 / 60)
    sent, plain = (
        Positions(codec, each, LAST, PERIOD, START, mode_bits=0x10) for each in (SLOW, replace(SLOW, sines=()))
    )
    # the ramps of the offset are raised cosines: half of it each; the sine turns through whole periods
    assert direction * (plain.planned(LAST) - START) == pytest.approx(0.05 * (0.15 + 0.1 + 0.8) / STEP, abs=2)
    fine = np.linspace(0.0, LAST * PERIOD, LAST * 400 + 1)
    wave = set_point(SLOW, fine)
    exact = np.concatenate([[0.0], np.cumsum((wave[1:] + wave[:-1]) / 2 * np.diff(fine))])[400::400]
    travelled = direction * np.array([sent.planned(k) - START for k in range(LAST)]) * STEP
    assert travelled == pytest.approx(exact, abs=2e-6)  # sent before SYNC k, reached at SYNC k + 1
    assert sent.planned(LAST) == sent.planned(LAST + 1000) == sent.planned(LAST - 1)

    speed = sent.velocity(59)
    assert speed == Velocities(codec, SLOW, LAST, PERIOD).planned(59)
    one_cycle = speed * codec.velocity_unit * PERIOD * codec.increments
    resting = sent.ramped(60, speed)  # a ramp goes on from the place sent last
    assert resting == pytest.approx(sent.planned(59) + one_cycle, abs=1)
    assert [sent.ramped(cycle, 0) for cycle in (61, 62)] == [resting, resting]  # never a jump to anywhere else


def test_a_position_beyond_32_bits_is_refused_before_anything_moves() -> None:
    codec = Codec(100.0, 0.25, 10.0, increments=1e6, velocity_unit=1e-3 / 60)
    with pytest.raises(LimitExceeded, match=r"position .* does not fit 32 bits"):
        Positions(codec, SLOW, LAST, PERIOD, 2**31 - 1000, 0)


ENVELOPE = DriveEnvelope(0.1, 200.0, (-1.0, 1.0), "rad", "N m")


@pytest.mark.parametrize(
    ("reading", "message"),
    [
        ((1.0, -0.1, 200.0), None),
        ((1.5, 0.0, 0.0), "position 1.5 rad is outside -1 to 1 rad"),
        ((-1.5, 0.0, 0.0), "position -1.5 rad is outside -1 to 1 rad"),
        ((0.0, -0.2, 0.0), "velocity -0.2 rad/s is beyond 0.1 rad/s"),
        ((0.0, 0.0, 300.0), "effort 300 N m is beyond 200 N m"),
        ((math.nan, 0.0, 0.0), "position nan rad is outside -1 to 1 rad"),
        ((0.0, math.nan, 0.0), "velocity nan rad/s is beyond 0.1 rad/s"),
        ((0.0, 0.0, math.nan), "effort nan N m is beyond 200 N m"),
    ],
)
def test_a_reading_outside_the_envelope_is_told(reading: tuple[float, float, float], message: str | None) -> None:
    violation = ENVELOPE.violation(*reading)
    assert (violation and violation[0]) == message


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
    ("position", "velocity", "message"),
    [
        (-2.0, 0.5, ""),
        (2.1, 0.1, "target position 2.1 rad is outside -2 to 2 rad"),
        (1.0, 0.6, "velocity 0.6 rad/s must be above 0 and at most 0.5 rad/s"),
    ],
)
def test_moves(position: float, velocity: float, message: str) -> None:
    with pytest.raises(LimitExceeded, match=f"joint_1: {message}") if message else nullcontext():
        check_move(AXIS, position, velocity)


MANY = (SineCommand(1.0, 0.001, 0.0),) * 17


@pytest.mark.parametrize(
    ("change", "start", "message"),
    [
        ({"velocity_limit": 0.06}, 0.0, "peak velocity 0.07 rad/s is beyond the limit of 0.06 rad/s"),
        ({"sines": (SineCommand(2.0, math.nan, 0.0),)}, 0.0, "peak velocity nan rad/s"),
        ({"sines": (SineCommand(126.0, 0.001, 0.0),)}, 0.0, "126 Hz is not below half the sample rate of 250 Hz"),
        ({"sines": MANY}, 0.0, "17 sines are more than the drive's 16"),
        ({"sines": MANY, "mode": SweepMode.HOST_STREAMED}, 0.0, ""),
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
    with pytest.raises(LimitExceeded, match=f"joint_1: {message}") if message else nullcontext():
        check_sweep(AXIS, replace(SWEEP, **change), start, 0.004)


NOISE = NoiseCommand(
    **{name: getattr(SWEEP, name) for name in ExcitationCommand.__dataclass_fields__},
    effort=60.0,
    lowest=2.0,
    highest=40.0,
    seed=7,
    softening=0.5,
)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({}, ""),
        ({"velocity_limit": 0.04}, "peak velocity 0.05 rad/s is beyond"),
        ({"position_window": (-0.1, 0.1)}, "highest position"),
        ({"velocity_limit": 3.0}, "velocity limit 3 rad/s"),
        ({"effort_limit": 9000.0}, "effort limit 9000 N m"),
        ({"effort_limit": 50.0}, "RMS of the injected effort 60 N m must be above 0 and at most 50 N m"),
        ({"effort": -1.0}, "RMS of the injected effort -1 N m"),
        ({"softening": 0.0}, "softening 0 "),
        ({"softening": 1.1}, "softening 1.1 "),
        ({"softening": math.nan}, "softening nan "),
        ({"highest": 125.0}, "band 2 to 125 Hz"),
        ({"lowest": 41.0}, "band 41 to 40 Hz"),
        ({"seed": -1}, "seed -1"),
        ({"seed": 1 << 32}, "seed 4294967296"),
        ({"ramp": 0.0}, "ramp"),
    ],
)
def test_noise_that_is_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(LimitExceeded, match=f"joint_1: {message}") if message else nullcontext():
        check_noise(AXIS, replace(NOISE, **change), 0.0)


@given(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6))
@example(-0.53232, -0.53232 + 4e-8)
def test_a_value_is_told_from_a_limit_that_it_differs_from(value: float, limit: float) -> None:
    shown, most = distinct(value, limit)
    assert (shown == most) == (value == limit) or {value, limit} == {0.0, -0.0}
    assert float(shown) == pytest.approx(value, rel=1e-4)
    assert distinct(0.5, 0.25, 0.75) == ("0.5", "0.25", "0.75")
