"""What one small sine tells of the channels, on signals whose units, signs, delays and noise are known."""

from typing import Any

import numpy as np
import pytest

from drivers.commission.channels import judge
from drivers.ports import ChannelTiming

RATE, FREQUENCY, OFFSET, INERTIA, FRICTION = 250.0, 2.0, 0.015, 300.0, 150.0


def columns(*, scale: float = 1.0, late: float = 0.0, effort: float = 1.0, noise: float = 0.0) -> dict[str, Any]:
    """Four seconds of a turn with a sine on it; velocity times `scale` and `late` s, effort times `effort`."""
    time, angular = np.arange(int(4 * RATE)) / RATE, 2 * np.pi * FREQUENCY
    random = np.random.default_rng(3)

    def speed(at: Any) -> Any:
        return OFFSET + 0.6 * OFFSET * np.sin(angular * at)

    acceleration = 0.6 * OFFSET * angular * np.cos(angular * time)
    return {
        "time": time,
        "position": OFFSET * time - 0.6 * OFFSET / angular * np.cos(angular * time),
        "velocity": scale * speed(time - late) + noise * random.standard_normal(len(time)),
        "effort": effort * (INERTIA * acceleration + FRICTION),
        "velocity_setpoint": speed(time + 0.01),
    }


def judged(content: dict[str, Any], delay: float = 0.0) -> list[Any]:
    return judge(content, FREQUENCY, OFFSET, ChannelTiming(velocity_delay=delay), "rad", "N m")


def test_sound_channels_fit_and_tell_delay_and_noise() -> None:
    told = judged(columns(noise=1e-4))
    assert not [each for each in told if each.fits is False]
    assert "10.00 ms behind the set-point" in " ".join(each.what for each in told)
    noise = next(each.what for each in told if each.check == "noise" and each.what.startswith("velocity"))
    assert float(noise.split()[1]) == pytest.approx(1e-4, rel=0.1)


@pytest.mark.parametrize(
    ("content", "delay", "names"),
    [
        (columns(scale=2.0), 0.0, {"unit"}),
        (columns(scale=60.0), 0.0, {"unit"}),
        (columns(scale=-1.0), 0.0, {"sign", "unit", "delay"}),
        (columns(effort=-1.0), 0.0, {"sign"}),
        (columns(late=0.005), 0.0, {"delay"}),
        (columns(late=0.005), 0.005, set[str]()),  # as the profile tells it
    ],
)
def test_a_wrong_channel_is_told_by_its_name(content: dict[str, Any], delay: float, names: set[str]) -> None:
    assert {each.check for each in judged(content, delay) if each.fits is False} == names
