"""Pseudo-random torque: every multiple of 1/period in a band with equal amplitude and random phase."""

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


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
