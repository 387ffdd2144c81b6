"""The velocity set-point of a sweep (`drivers.ports.SweepCommand`), used by the host to stream it and to check it
first.
"""

import numpy as np
from numpy.typing import NDArray

from drivers.ports import SweepCommand

Array = NDArray[np.float64]


def set_point(command: SweepCommand, time: Array) -> Array:
    """``e(t) (offset + sum a sin(2 pi f (t - t0) + phi))`` in rad/s (m/s) at `time` (n,), s from the sweep's start."""
    value = np.full_like(time, command.offset_velocity)
    for sine in command.sines:
        value += sine.amplitude * np.sin(2 * np.pi * sine.frequency * (time - command.measure_from) + sine.phase)
    return envelope(command, time) * value


def envelope(command: SweepCommand, time: Array) -> Array:
    """e(t): raised cosine over `ramp`, one, raised cosine down; zero before and after. (n,)"""
    since_end = np.minimum(time, command.duration - time)
    return 0.5 - 0.5 * np.cos(np.pi * np.clip(since_end / command.ramp, 0.0, 1.0))


def travel(command: SweepCommand, step: float = 1e-3) -> tuple[float, float]:
    """Lowest and highest position of the set-point relative to the start, rad (m), by the trapezoidal rule."""
    count = max(2, round(command.duration / step) + 1)
    time = np.linspace(0.0, command.duration, count)
    velocity = set_point(command, time)
    path = np.concatenate([[0.0], np.cumsum((velocity[1:] + velocity[:-1]) / 2 * np.diff(time))])
    return float(path.min()), float(path.max())
