"""The velocity set-point of a sweep, as the measuring function generates it (docs/reference/virtual-drive.md)."""

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
