"""Signals filtered in the frequency domain: derivatives, springs, delays."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

ENDING = 0.05  # s, in which the slope at the end of a record decreases to zero


@dataclass(frozen=True)
class Spectrum:
    """Signals (n, t) in the frequency domain: their first values (n, 1), and the transform (n, bins) of the rest.

    A signal is assumed constant before its first sample, so a start from standstill is exact. After its last sample it
    returns to the first value, so smoothly and slowly that the response to the end does not reach the start. All of
    that is linear: the spectrum of a sum is the sum of the spectra.
    """

    first: Array
    away: Complex

    def __add__(self, other: "Spectrum") -> "Spectrum":
        return Spectrum(self.first + other.first, self.away + other.away)

    def __mul__(self, response: Complex | Array | float) -> "Spectrum":
        """Filtered by a response (n or 1, bins) of `bins(t, rate)`, or multiplied by a number."""
        constant = response[:, :1].real if isinstance(response, np.ndarray) else response
        return Spectrum(self.first * constant, np.multiply(self.away, response, dtype=np.complex128))

    def signal(self, count: int) -> Array:
        """The signals (n, count)."""
        return np.asarray(back(count, self.away) + self.first)


def spectrum(signal: Array, rate: float) -> Spectrum:
    """The spectrum of signals (n, t)."""
    count = signal.shape[1]
    first, last = signal[:, :1], signal[:, -1:]
    turning, fading = _return(count, rate)
    extended = np.zeros((len(signal), _padded(count)))
    np.subtract(signal, first, out=extended[:, :count])
    np.multiply(last - first, turning, out=extended[:, count : 2 * count])
    extended[:, count : 2 * count] += (last - signal[:, -2:-1]) * ENDING * rate * fading
    return Spectrum(first, np.asarray(np.fft.rfft(extended), dtype=np.complex128))


@lru_cache(maxsize=8)
def _return(count: int, rate: float) -> tuple[Array, Array]:
    """How a signal returns to its first value after its end: by position, and by slope."""
    after = np.arange(1.0, count + 1) / (ENDING * rate)
    return (1 + np.cos(np.arange(1.0, count + 1) * (np.pi / (count + 1)))) / 2, after * np.exp(-after)


def in_frequency(signal: Array, rate: float) -> Array:
    """Derivative of signals (n, t)."""
    return back(signal.shape[1], derivative_spectrum(signal, rate))


def through(signal: Array, rate: float, response: Complex) -> Array:
    """Signals (n, t) filtered by a response (n or 1, bins) of `bins(t, rate)`; constant before their first sample."""
    return (spectrum(signal, rate) * response).signal(signal.shape[1])


def derivative_spectrum(signal: Array, rate: float) -> Complex:
    """Transform (n, bins) of the derivative of signals (n, t), see `Spectrum`."""
    frequencies = 2j * np.pi * bins(signal.shape[1], rate)
    return np.multiply(spectrum(signal, rate).away, frequencies, dtype=np.complex128)


def back(count: int, transform: Complex) -> Array:
    """The signals (n, count) of a transform (n, bins)."""
    return np.fft.irfft(transform, _padded(count))[:, :count].astype(np.float64, copy=False)


def bins(samples: int, rate: float) -> Array:
    """Frequencies, Hz, of `in_frequency`."""
    return np.fft.rfftfreq(_padded(samples), 1 / rate).astype(np.float64)


def _padded(samples: int) -> int:
    # 3 times the record: padding, so that the response after the end does not wrap around to the start
    return next_fast_len(3 * samples, real=True)
