"""The correction of delay and smoothing against sines whose shift is known exactly."""

import numpy as np
import pytest

from drivers.ports import ChannelTiming
from service import BadInput
from service.model import Recording
from service.model.channels import HALF, align, noise_gain

RATE = 250.0
COUNT = 1000
TIMINGS = {
    "delay": ChannelTiming(effort_delay=0.7e-3),
    "smoothing": ChannelTiming(effort_smoothing=2e-3),
    "both": ChannelTiming(effort_delay=0.5e-3, effort_smoothing=1.5e-3, velocity_delay=0.25e-3),
    "more than a sample": ChannelTiming(effort_delay=6.1e-3, velocity_delay=4e-3, velocity_smoothing=0.5e-3),
    "early": ChannelTiming(effort_delay=-5e-3),
}


def recorded(frequency: float, timing: ChannelTiming) -> Recording:
    """Sines of unit amplitude, sin(w t) at the instant of a row, as a drive of that timing gives them."""
    time = np.arange(COUNT) / RATE
    w = 2 * np.pi * frequency

    def late(delay: float, smoothing: float) -> np.ndarray:
        return np.imag(np.exp(1j * w * (time - delay)) / (1 + 1j * w * smoothing))

    return Recording(
        time=time,
        effort=late(timing.effort_delay, timing.effort_smoothing),
        velocity=late(timing.velocity_delay, timing.velocity_smoothing),
        position=np.sin(w * time),
        load_position=np.cos(w * time),
    )


@pytest.mark.parametrize("name", TIMINGS)
@pytest.mark.parametrize("frequency", [0.5, 2.0, 5.0, 11.3, 20.0])
def test_a_shifted_sine_comes_back_where_it_was(frequency: float, name: str) -> None:
    timing = TIMINGS[name]
    aligned = align(recorded(frequency, timing), timing)
    truth = np.sin(2 * np.pi * frequency * aligned.time)
    assert np.abs(aligned.effort - truth).max() < 1e-6
    assert np.abs(aligned.velocity - truth).max() < 1e-6
    np.testing.assert_array_equal(aligned.position, np.sin(2 * np.pi * frequency * aligned.time))


def test_ends_are_cut_from_every_column_alike() -> None:
    timing = ChannelTiming(effort_delay=8e-3, velocity_delay=-4e-3)  # two samples late, one early
    aligned = align(recorded(2.0, timing), timing)
    assert aligned.load_position is not None
    lengths = {len(aligned.time), len(aligned.effort), len(aligned.velocity), len(aligned.load_position)}
    assert lengths == {COUNT - 2 * HALF - 3}
    assert aligned.time[0] == (HALF + 1) / RATE
    assert aligned.time[-1] == (COUNT - 1 - HALF - 2) / RATE


def test_what_has_nothing_to_correct_stays_as_it_is() -> None:
    recording = recorded(2.0, ChannelTiming())
    assert align(recording, ChannelTiming()) is recording
    timing = ChannelTiming(effort_smoothing=1e-3)
    recording = recorded(3.0, timing)
    np.testing.assert_array_equal(align(recording, timing).velocity, recording.velocity[HALF:-HALF])


def test_white_noise_grows_as_stated() -> None:
    timing = ChannelTiming(effort_delay=0.5e-3, effort_smoothing=2e-3)
    rng = np.random.default_rng(1)
    for rate in (250.0, 1000.0):
        noise = rng.standard_normal(200_000)
        time = np.arange(len(noise)) / rate
        aligned = align(Recording(time=time, effort=noise, velocity=noise, position=noise), timing)
        stated = noise_gain(timing.effort_delay, timing.effort_smoothing, rate)
        assert aligned.effort.std() == pytest.approx(stated, rel=0.02)
    assert noise_gain(0.0, 0.0, 1000.0) == 1.0


def test_too_few_samples_are_refused() -> None:
    column = np.arange(13.0)
    recording = Recording(time=column / RATE, effort=column, velocity=column, position=column)
    with pytest.raises(BadInput, match="13 samples are too few"):
        align(recording, ChannelTiming(effort_delay=1e-3))
