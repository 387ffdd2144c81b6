"""Excitation from the parameters of the measuring function: speed set-points, and torque noise added to them.

Set-point ``e(t) (offset + sum a_i sin(2 pi f_i (t - t0) + phi_i))``, t0 = ramp + settle, with the envelope
``e = (1 - cos(pi t / ramp)) / 2`` while rising, one, and mirrored while falling. Injected torque ``e(t) n(t)``, where n
has the given period from t = 0 on.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulator.waveform import torque_noise

Array = NDArray[np.float64]

_LONGEST = 600.0  # s
_HIGHEST = 500.0  # Hz


@dataclass(frozen=True, slots=True)
class Sweep:
    """Parameters as in 2100h to 2103h; `sines` are (Hz, rev/min, rad)."""

    offset: float
    ramp: float
    settle: float
    period: float
    periods: int
    sines: tuple[tuple[float, float, float], ...]

    @property
    def duration(self) -> float:
        """From standstill to standstill, s."""
        return 2 * self.ramp + self.settle + self.period * self.periods

    @property
    def peak(self) -> float:
        """An upper bound of the speed, rev/min."""
        return abs(self.offset) + sum(abs(amplitude) for _, amplitude, _ in self.sines)

    def valid(self) -> bool:
        """Whether all numbers are finite, times are positive, and duration and frequencies are within their limits."""
        numbers = [self.offset, self.ramp, self.settle, self.period, *(n for sine in self.sines for n in sine)]
        return (
            all(math.isfinite(number) for number in numbers)
            and self.ramp > 0
            and self.settle >= 0
            and self.period > 0
            and self.duration <= _LONGEST
            and all(0 < frequency <= _HIGHEST for frequency, _, _ in self.sines)
        )

    def setpoints(self, cycle: float) -> Array:
        """Speed at the end of every drive cycle (m,), rev/s."""
        time = self._time(cycle)
        speed = np.full_like(time, self.offset / 60)
        for frequency, amplitude, phase in self.sines:
            speed += amplitude / 60 * np.sin(2 * np.pi * frequency * (time - self.ramp - self.settle) + phase)
        return self.envelope(cycle) * speed

    def envelope(self, cycle: float) -> Array:
        """e at the end of every drive cycle (m,)."""
        time = self._time(cycle)
        edge: Array = np.clip(np.minimum(time, self.duration - time) / self.ramp, 0.0, 1.0)
        return (1 - np.cos(np.pi * edge)) / 2

    def _time(self, cycle: float) -> Array:
        return np.arange(1, round(self.duration / cycle) + 1, dtype=np.float64) * cycle


@dataclass(frozen=True, slots=True)
class Noise:
    """Parameters as in 2104h: RMS in N m of the motor, band in Hz, seed of the phases."""

    rms: float
    lowest: float
    highest: float
    seed: int

    def torques(self, sweep: Sweep, cycle: float) -> Array:
        """Injected torque at the end of every drive cycle of a valid sweep (m,), N m. Raises ValueError for invalid
        parameters.
        """
        if not (math.isfinite(self.rms) and self.rms >= 0 and 0 <= self.lowest <= self.highest <= _HIGHEST):
            raise ValueError(f"{self} cannot be")
        period = torque_noise(self.rms, self.lowest, self.highest, sweep.period, self.seed, cycle)
        envelope = sweep.envelope(cycle)
        torques: Array = envelope * np.resize(period, len(envelope))
        return torques
