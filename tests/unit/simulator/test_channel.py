"""The set-point of a sweep by hand; a channel's delay and smoothing against the formula."""

from collections.abc import Callable

import numpy as np
import pytest

from simulator import Measurement, Scenario, SweepRun, Waveform, run_sweeps
from simulator.plant import Channel
from tests.unit.simulator.conftest import line

STEP = 0.00025


def test_a_step_in_pieces_follows_the_exponential() -> None:
    smoothing, delay = 0.0017, 0.0005
    channel = Channel(2, STEP, delay, smoothing)
    channel.restart(1, 5.0)
    signal = np.tile([1.0, 5.0], (60, 1))
    signal[:20, 0] = 0.0
    out = np.concatenate([channel.pass_on(signal[k : k + 7]) for k in range(0, 60, 7)])
    # The signal rises straight from 0 at step 19 to 1 at step 20; both come two steps later.
    since = np.arange(60) - 21.0
    rise = smoothing / STEP
    expected = np.where(since > 0, 1 - rise * (1 - np.exp(-1 / rise)) * np.exp(-(since - 1) / rise), 0.0)
    np.testing.assert_allclose(out[:, 0], expected, atol=1e-12)
    np.testing.assert_allclose(out[:, 1], 5.0)


def test_only_the_smoothed_channels_of_a_sweep_change(
    noise_free: Callable[[str], Scenario], sweep: Callable[..., SweepRun]
) -> None:
    rigid, run = noise_free("rigid"), sweep("joint_1")
    slow = Measurement(effort_smoothing=0.0015, velocity_delay=0.00043, velocity_smoothing=0.0005)
    (plain,) = run_sweeps(rigid, [run], seed=1)
    (smooth,) = run_sweeps(rigid.model_copy(update={"measurement": slow}), [run], seed=1)
    for name in ("position", "load_position", "load_velocity", "velocity_setpoint"):
        np.testing.assert_array_equal(plain[name], smooth[name])
    w = 2 * np.pi * 5.0
    effort = line(smooth, "effort", 5.0, run) / line(plain, "effort", 5.0, run)
    assert effort == pytest.approx(1 / (1 + 1j * w * 0.0015), rel=1e-4)
    velocity = line(smooth, "velocity", 5.0, run) / line(plain, "velocity", 5.0, run)
    assert velocity == pytest.approx(np.exp(-1j * w * 0.00043) / (1 + 1j * w * 0.0005), rel=1e-4)


def test_no_ramp_is_a_step() -> None:
    wave = Waveform(0.01, (), 1.0, 1, 0.0, 0.0)
    np.testing.assert_array_equal(wave.velocity(np.array([-1e-3, 0.5, 1.001])), [0.0, 0.01, 0.0])
