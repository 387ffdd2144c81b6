"""The velocity set-point of a sweep, as the measuring function generates it (docs/reference/virtual-drive.md)."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Waveform:
    """``e(t) (offset + sum a sin(2 pi f (t - t0) + phase))``, t0 = ramp + settle; e: raised cosine up, one, down."""

    offset_velocity: float  # rad/s, signed
    sines: tuple[tuple[float, float, float], ...]  # (frequency Hz, amplitude rad/s, phase rad)
    period: float  # s
    periods: int
    ramp: float  # s
    settle: float  # s

    @property
    def measure_from(self) -> float:
        """t0, s: start of the window of whole periods."""
        return self.ramp + self.settle

    @property
    def duration(self) -> float:
        """From standstill to standstill, s."""
        return 2 * self.ramp + self.settle + self.period * self.periods

    def velocity(self, time: Array) -> Array:
        """Set-point at any times (n,), s since the start: (n,) rad/s; zero outside the sweep."""
        wave = np.full_like(time, self.offset_velocity)
        for frequency, amplitude, phase in self.sines:
            wave += amplitude * np.sin(2 * np.pi * frequency * (time - self.measure_from) + phase)
        return wave * self.envelope(time)

    def envelope(self, time: Array) -> Array:
        """e(t) at any times (n,), s since the start; zero outside."""
        to_edge = np.minimum(time, self.duration - time)
        if self.ramp == 0:
            return (to_edge >= 0).astype(float)
        return (1 - np.cos(np.pi * np.clip(to_edge / self.ramp, 0.0, 1.0))) / 2


def lines(lowest: float, highest: float, period: float) -> range:
    """The k whose frequency k / period, Hz, lies in the band (ends included) and is not zero."""
    return range(max(1, math.ceil(lowest * period - 1e-9)), math.floor(highest * period + 1e-9) + 1)


def torque_noise(rms: float, lowest: float, highest: float, period: float, seed: int, cycle: float) -> Array:
    """One period at the cycles 1, 2, ... (n,), in the unit of `rms`; n = period / cycle, to be repeated.

    Phases are from NumPy's PCG64 by `seed`, line by line. Raises ValueError if the period is not a whole number of
    cycles, no line is in the band, or a line is not below half the cycle rate.
    """
    count, band = round(period / cycle), lines(lowest, highest, period)
    if not math.isclose(count * cycle, period, rel_tol=1e-9):
        raise ValueError(f"period {period} s is not a multiple of {cycle} s")
    if not band or not 2 * band[-1] < count:
        raise ValueError(f"band {lowest} to {highest} Hz: no line, or one above the rate, with a period of {period} s")
    spectrum = np.zeros(count // 2 + 1, dtype=complex)
    phases = np.random.default_rng(seed).uniform(0.0, 2 * np.pi, len(band))
    spectrum[band.start : band.stop] = rms * math.sqrt(2 / len(band)) * np.exp(1j * (phases - np.pi / 2))
    return np.roll(np.fft.irfft(spectrum, count, norm="forward") / 2, -1)
