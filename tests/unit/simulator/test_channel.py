"""The set-point of a sweep by hand; a channel's delay and smoothing against the formula."""

from collections.abc import Callable

import numpy as np
import pytest

from simulator import Measurement, Scenario, SweepRun, Waveform, run_sweeps
from simulator.plant import Channel
from tests.unit.simulator.conftest import line

STEP = 0.00025


def test_an_idle_channel_hands_on_what_it_gets() -> None:
    signal = np.random.default_rng(1).standard_normal((50, 3))
    assert Channel(3, STEP, 0.0, 0.0).pass_on(signal) is signal


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


@pytest.mark.parametrize("frequency", [5.0, 90.0])
def test_lines_are_turned_and_shrunk_as_the_formula_says(frequency: float) -> None:
    smoothing, delay, steps = 0.002, 0.001, 40_000
    time = np.arange(steps)[:, None] * STEP
    line = np.asarray(np.exp(2j * np.pi * frequency * time), dtype=complex)
    out = Channel(1, STEP, delay, smoothing).pass_on(np.real(line))[-4000:]
    response = 2 * np.mean(out * line[-4000:].conj())
    w = 2 * np.pi * frequency
    assert response == pytest.approx(np.exp(-1j * w * delay) / (1 + 1j * w * smoothing), abs=(w * STEP) ** 2 / 10)


def test_only_the_smoothed_channels_of_a_sweep_change(
    noise_free: Callable[[str], Scenario], sweep: Callable[..., SweepRun]
) -> None:
    rigid, run = noise_free("rigid"), sweep("joint_1")
    slow = Measurement(effort_smoothing=0.0015, velocity_delay=0.00025, velocity_smoothing=0.0005)
    (plain,) = run_sweeps(rigid, [run], seed=1)
    (smooth,) = run_sweeps(rigid.model_copy(update={"measurement": slow}), [run], seed=1)
    for name in ("position", "load_position", "load_velocity", "velocity_setpoint"):
        np.testing.assert_array_equal(plain[name], smooth[name])
    w = 2 * np.pi * 5.0
    effort = line(smooth, "effort", 5.0, run) / line(plain, "effort", 5.0, run)
    assert effort == pytest.approx(1 / (1 + 1j * w * 0.0015), rel=1e-4)
    velocity = line(smooth, "velocity", 5.0, run) / line(plain, "velocity", 5.0, run)
    assert velocity == pytest.approx(np.exp(-1j * w * 0.00025) / (1 + 1j * w * 0.0005), rel=1e-4)


def test_a_delay_between_two_steps_turns_a_line_by_just_that(
    noise_free: Callable[[str], Scenario], sweep: Callable[..., SweepRun]
) -> None:
    rigid, run, delay = noise_free("rigid"), sweep("joint_1"), 0.00043
    (plain,) = run_sweeps(rigid, [run], seed=1)
    late = rigid.model_copy(update={"measurement": Measurement(effort_delay=delay)})
    (delayed,) = run_sweeps(late, [run], seed=1)
    turn = line(delayed, "effort", 5.0, run) / line(plain, "effort", 5.0, run)
    assert turn == pytest.approx(np.exp(-2j * np.pi * 5.0 * delay), abs=2e-5)


WAVE = Waveform(offset_velocity=-0.01, sines=((2.0, 0.002, 0.5),), period=1.0, periods=3, ramp=0.4, settle=0.6)


def test_values() -> None:
    time = np.array([-0.1, 0.0, 0.2, 1.0, 1.125, 4.2, 4.4, 5.0])
    full = -0.01 + 0.002 * np.sin(2 * np.pi * 2.0 * (time - 1.0) + 0.5)
    envelope = np.array([0, 0, 0.5, 1, 1, 0.5, 0, 0])
    np.testing.assert_allclose(WAVE.velocity(time), envelope * full, atol=1e-15)


def test_no_ramp_is_a_step() -> None:
    wave = Waveform(0.01, (), 1.0, 1, 0.0, 0.0)
    np.testing.assert_array_equal(wave.velocity(np.array([-1e-3, 0.5, 1.001])), [0.0, 0.01, 0.0])
