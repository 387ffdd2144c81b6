r"""Bounds of travel and velocity by torque noise, from its command and the least inertia of the axis.

n lines of amplitude a = f sqrt(2/n), f the RMS, add up to at most n a = f sqrt(2 n). With the free inertia J, whose
motion the speed control only reduces, they cause

    velocity  sum a / (2 pi f_k J),     travel  sum a / ((2 pi f_k)^2 J)   in either direction.
"""

import math

import numpy as np
from numpy.typing import NDArray

from drivers.ports import NoiseCommand, SweepCommand

Array = NDArray[np.float64]
Command = SweepCommand | NoiseCommand

ANSWER = 2.0  # maximum ratio of effort to injected torque, including the response of the speed control


def noise_velocity(command: NoiseCommand, inertia: float) -> float:
    """Bound of the noise's part of the velocity, rad/s (m/s); `inertia` kg m^2 (kg)."""
    omega = _omega(command)
    return _amplitude(command) * float(np.sum(1 / omega)) / inertia


def noise_way(command: NoiseCommand, inertia: float) -> float:
    """Bound of the travel by the noise in either direction, rad (m)."""
    omega = _omega(command)
    return _amplitude(command) * float(np.sum(1 / omega**2)) / inertia


def noise_effort(command: NoiseCommand) -> float:
    """Bound of the effort with this noise, N m (N)."""
    return ANSWER * _amplitude(command) * len(_omega(command))


def _omega(command: NoiseCommand) -> Array:
    first, last = math.ceil(command.lowest * command.period - 1e-9), math.floor(command.highest * command.period + 1e-9)
    return np.asarray(2 * np.pi * np.arange(max(first, 1), last + 1) / command.period, dtype=np.float64)


def _amplitude(command: NoiseCommand) -> float:
    return command.effort * math.sqrt(2 / max(len(_omega(command)), 1))
