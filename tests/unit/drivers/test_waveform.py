"""The set-point of a sweep, by numbers computed by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest

from drivers.cia402.waveform import envelope, set_point, travel
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
