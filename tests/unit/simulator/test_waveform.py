"""The set-point of a sweep, against numbers worked out by hand."""

import numpy as np
import pytest

from simulator import Waveform

WAVE = Waveform(offset_velocity=-0.01, sines=((2.0, 0.002, 0.5),), period=1.0, periods=3, ramp=0.4, settle=0.6)


def test_times() -> None:
    assert WAVE.measure_from == pytest.approx(1.0)
    assert WAVE.duration == pytest.approx(4.4)


def test_values() -> None:
    time = np.array([-0.1, 0.0, 0.2, 1.0, 1.125, 4.2, 4.4, 5.0])
    full = -0.01 + 0.002 * np.sin(2 * np.pi * 2.0 * (time - 1.0) + 0.5)
    envelope = np.array([0, 0, 0.5, 1, 1, 0.5, 0, 0])
    np.testing.assert_allclose(WAVE.velocity(time), envelope * full, atol=1e-15)


def test_no_ramp_is_a_step() -> None:
    wave = Waveform(0.01, (), 1.0, 1, 0.0, 0.0)
    np.testing.assert_array_equal(wave.velocity(np.array([-1e-3, 0.5, 1.001])), [0.0, 0.01, 0.0])
