"""The set-point of a sweep, as a velocity and as positions, by hand and by integrals in closed form."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drivers.canopen.set_points import Positions, Velocities
from drivers.canopen.units import Codec
from drivers.cia402.waveform import envelope, set_point, travel
from drivers.errors import LimitExceeded
from drivers.ports import Sine, SweepCommand
from tests.unit.drivers.given import sweep


def command(*sines: Sine, offset: float = 0.1) -> SweepCommand:
    return replace(sweep(), sines=sines, offset_velocity=offset, ramp=0.5, settle=0.25)


def test_envelope_by_hand() -> None:
    when = np.array([-1.0, 0.0, 0.125, 0.25, 0.5, 1.0, 2.75, 3.0, 3.25, 4.0])
    quarter = 0.5 - 0.5 * math.cos(math.pi / 4)
    assert envelope(command(), when) == pytest.approx([0, 0, quarter, 0.5, 1, 1, 1, 0.5, 0, 0])


def test_phase_counts_from_the_window() -> None:
    sweep = command(Sine(2.0, 0.03, 0.0), Sine(5.0, 0.01, math.pi / 2))
    # t0 = 0.75 s; an eighth of a second later the 2 Hz sine is at its peak, the 5 Hz one at 90 + 225 degrees
    value = set_point(sweep, np.array([0.75, 0.875, 1.0]))
    root = math.sqrt(0.5)
    assert value == pytest.approx([0.1 + 0.01, 0.1 + 0.03 - 0.01 * root, 0.1])


def test_negative_offset_mirrors() -> None:
    when = np.linspace(0, 3.25, 50)
    assert set_point(command(offset=-0.1), when) == pytest.approx(-set_point(command(), when))


def test_standstill_at_both_ends() -> None:
    sweep = command(Sine(3.0, 0.05, 1.0))
    assert set_point(sweep, np.array([0.0, sweep.duration])) == pytest.approx([0.0, 0.0])


def test_travel_by_hand() -> None:
    # ramps of raised cosine count half: 0.1 (0.25 + 0.25 + 2 + 0.25)
    assert travel(command()) == pytest.approx((0.0, 0.275), abs=1e-6)
    assert travel(command(offset=-0.1)) == pytest.approx((-0.275, 0.0), abs=1e-6)


PERIOD, LAST, START = 0.008, 150, 5000  # s, cycles, increments
CODEC = Codec(100.0, 0.25, 10.0, increments=1e6, velocity_unit=1e-3 / 60)
STEP = 2 * np.pi / (100.0 * 1e6)  # rad, one increment


def slow(**changes: Any) -> SweepCommand:
    slow = {"offset_velocity": 0.05, "sines": (Sine(5.0, 0.02, 0.3),), "period": 0.4, "ramp": 0.15, "settle": 0.1}
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
