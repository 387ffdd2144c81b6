r"""How far and how fast torque noise may move an axis: bounds from its command and the least inertia it may have.

n lines of amplitude a = f sqrt(2/n), f the RMS, add up to no more than n a = f sqrt(2 n). In the free inertia J, which
the speed control only holds back, they make

    velocity  sum a / (2 pi f_k J),     way  sum a / ((2 pi f_k)^2 J)   to either side.
"""

import math

import numpy as np
from numpy.typing import NDArray

from drivers.ports import NoiseCommand, SweepCommand

Array = NDArray[np.float64]
Command = SweepCommand | NoiseCommand

ANSWER = 2.0  # most that effort grows over what is injected, by the speed control's answer


def noise_velocity(command: NoiseCommand, inertia: float) -> float:
    """Bound of the noise's part of the velocity, rad/s (m/s); `inertia` kg m^2 (kg)."""
    omega = _omega(command)
    return _amplitude(command) * float(np.sum(1 / omega)) / inertia


def noise_way(command: NoiseCommand, inertia: float) -> float:
    """Bound of the noise's way to either side, rad (m)."""
    omega = _omega(command)
    return _amplitude(command) * float(np.sum(1 / omega**2)) / inertia


def noise_effort(command: NoiseCommand) -> float:
    """Bound of the effort that the noise takes, N m (N)."""
    return ANSWER * _amplitude(command) * len(_omega(command))


def _omega(command: NoiseCommand) -> Array:
    first, last = math.ceil(command.lowest * command.period - 1e-9), math.floor(command.highest * command.period + 1e-9)
    return np.asarray(2 * np.pi * np.arange(max(first, 1), last + 1) / command.period, dtype=np.float64)


def _amplitude(command: NoiseCommand) -> float:
    return command.effort * math.sqrt(2 / max(len(_omega(command)), 1))
