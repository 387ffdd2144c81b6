"""Disturbances that do not repeat: a noise floor far above the sensor noise is not noise.

The noise floor comes from repeats. Motion or torque that differs in each repeat (floor vibration, stick-slip friction,
a brake that drags intermittently) increases the floor and cannot be distinguished from it. The sensor noise is measured
in the top band of the record, where there is no machine motion.
"""

from dataclasses import dataclass

import numpy as np

from service.diagnosis.fit.equations import Equations
from service.diagnosis.rows.signals import EVERY
from service.model import Array


@dataclass(frozen=True, slots=True)
class Unrepeated:
    """RMS, N m (N), of the differences between repeats, and of the sensor noise in the same band; the
    frequency, Hz, that contains most of the difference, None if there is no such frequency.
    """

    rms: float
    sensor_rms: float
    frequency: float | None

    @property
    def is_physical(self) -> bool:
        # 4.0 times the sensor noise in the same band: coloured sensor noise gives about 2
        return self.rms > 4.0 * self.sensor_rms

    def sentence(self, joint: str, unit: str) -> str:
        where = "" if self.frequency is None else f", most of it at {self.frequency:.2g} Hz"
        return (
            f"{joint}: {self.rms:.3g} {unit} RMS does not repeat{where}; the sensor's own noise is "
            f"{self.sensor_rms:.3g} {unit}. What moves the axis differently each time cannot be named from repeats."
        )


def unrepeated(given: Equations, left: Array) -> Unrepeated | None:
    """Analysis of residuals (n, rows), N m (N), of a model; None if nothing is repeated."""
    usable, parts = given.tracks.usable, list[Array]()
    for group in given.groups:
        count = len(group.pieces)
        if count > 1:
            rows = np.stack([left[p.sweep, p.first : p.first + p.rows] for p in group.pieces])
            good = np.stack([usable[p.sweep, p.first : p.first + p.rows] for p in group.pieces]).all(axis=0)
            parts.extend(np.where(good, (rows - rows.mean(axis=0)) * np.sqrt(count / (count - 1)), 0.0))
    counted = sum(int(np.count_nonzero(part)) for part in parts)
    if not counted:
        return None
    power = np.mean([np.abs(np.fft.rfft(part)) ** 2 for part in parts], axis=0)
    highest = int(np.argmax(power))
    near = power[max(0, highest - 1) : highest + 2].sum() / power.sum()
    frequency = _between(power, highest) * given.tracks.rate / EVERY / usable.shape[1]
    rms = float(np.sqrt(sum(float(part @ part) for part in parts) / counted))
    # 0.5 of the power that does not repeat, at one frequency
    return Unrepeated(rms, given.sensor_noise, frequency if near > 0.5 else None)


def _between(power: Array, highest: int) -> float:
    """Frequency of a line between two bins, from the ratio of the power in both."""
    beside = {k: float(np.sqrt(power[k])) for k in (highest - 1, highest + 1) if 0 <= k < len(power)}
    other = max(beside, key=lambda k: beside[k])
    return highest + (other - highest) * beside[other] / (beside[other] + float(np.sqrt(power[highest])))
