"""What the drive writes down: torque with noise of several colours, speed from counted positions, 32 bit floats."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from tests.numeric.second_plant.machine import STEP, Raw

Array = NDArray[np.float64]
Random = np.random.Generator


@dataclass(frozen=True)
class Sensors:
    """How a drive measures; N m and rad on the joint side."""

    white: float  # N m RMS a sample
    slow: float  # N m RMS below `corner`
    corner: float  # Hz
    flicker: float  # N m RMS, about 1/f from 0.1 to 100 Hz
    count: float  # rad, one step of the encoder
    jumpy: float  # rad RMS of the encoder's own noise
    effort_step: float  # N m, 0: not quantised
    jitter: float  # of a sample, in the time stamps
    effort_delay: float = 0.0  # s
    effort_lag: float = 0.0  # s, first-order filter of the torque
    single: bool = True  # 32 bit

    @property
    def floor(self) -> float:
        """N m RMS of the torque's noise a sample."""
        return float(np.sqrt(self.white**2 + self.slow**2 + self.flicker**2 + self.effort_step**2 / 12))


@dataclass(frozen=True)
class Samples:
    """Columns (samples, m)."""

    time: Array
    effort: Array
    velocity: Array
    position: Array


def sample(sensors: Sensors, raw: Raw, rate: float, random: Random) -> Samples:
    """Every so many steps one row."""
    stride = round(1.0 / (rate * STEP))
    position = counted(sensors, raw.position, random)
    velocity = np.gradient(position, STEP, axis=0)
    effort = _late(raw.torque, sensors)[::stride]
    effort = effort + noise(sensors, effort.shape, rate, random)
    if sensors.effort_step:
        effort = np.round(effort / sensors.effort_step) * sensors.effort_step
    stamps = np.arange(effort.shape[0])[:, None] + np.zeros(effort.shape[1])
    stamps[1:] += np.clip(sensors.jitter * random.standard_normal(stamps[1:].shape), -0.2, 0.2)
    kind = np.float32 if sensors.single else np.float64
    columns = (column.astype(kind).astype(float) for column in (effort, velocity[::stride], position[::stride]))
    return Samples(stamps / rate, *columns)


def counted(sensors: Sensors, position: Array, random: Random) -> Array:
    """Positions as an encoder tells them."""
    seen = position + sensors.jumpy * random.standard_normal(position.shape)
    return np.round(seen / sensors.count) * sensors.count


def noise(sensors: Sensors, shape: tuple[int, ...], rate: float, random: Random) -> Array:
    """Of the torque, N m: white, low-passed, and a sum of first-order processes a decade apart, which is about 1/f."""
    total = sensors.white * random.standard_normal(shape)
    total += sensors.slow * _first_order(sensors.corner, shape, rate, random)
    for corner in (0.1, 1.0, 10.0, 100.0):
        total += sensors.flicker / 2.0 * _first_order(corner, shape, rate, random)
    return total


def _first_order(corner: float, shape: tuple[int, ...], rate: float, random: Random) -> Array:
    """Stationary, of variance one."""
    keep = float(np.exp(-2 * np.pi * corner / rate))
    drive = np.sqrt(1 - keep**2) * random.standard_normal(shape)
    drive[0] /= np.sqrt(1 - keep**2)
    return lfilter([1.0], [1.0, -keep], drive, axis=0)


def _late(torque: Array, sensors: Sensors) -> Array:
    """The torque as the drive tells it: through a first-order filter, then late by any part of a step."""
    told = torque
    if sensors.effort_lag:
        a = STEP / (2 * sensors.effort_lag)  # bilinear, so that the filter adds no delay of its own
        top, bottom = [a / (1 + a), a / (1 + a)], [1.0, -(1 - a) / (1 + a)]
        first = torque[:1] * (1 - top[0])
        told, _ = lfilter(top, bottom, torque, axis=0, zi=first)
    if sensors.effort_delay:
        place = np.arange(len(told)) - sensors.effort_delay / STEP
        cell = np.clip(np.floor(place).astype(int), 1, len(told) - 3)
        x = (np.clip(place, 0, len(told) - 1) - cell)[:, None]
        a, b, c, d = (told[cell + k] for k in (-1, 0, 1, 2))
        told = (
            -x * (x - 1) * (x - 2) / 6 * a
            + (x + 1) * (x - 1) * (x - 2) / 2 * b
            - (x + 1) * x * (x - 2) / 2 * c
            + (x + 1) * x * (x - 1) / 6 * d
        )
    return told
