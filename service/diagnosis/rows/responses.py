"""Signals filtered in the frequency domain: derivatives, springs, delays."""

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

ENDING = 0.05  # s, in which the slope at the end of a record decreases to zero
PADDED = 3  # times the record: padding, so that the response after the end does not wrap around to the start


def in_frequency(signal: Array, rate: float, response: Complex | None = None) -> Array:
    """Derivative of signals (n, t), times a response (n or 1, bins) of `bins(t, rate)`."""
    flat = np.ones((1, len(bins(signal.shape[1], rate))), dtype=np.complex128)
    return back(signal.shape[1], derivative_spectrum(signal, rate), flat if response is None else response)


def through(signal: Array, rate: float, response: Complex) -> Array:
    """Signals (n, t) filtered by a response (n or 1, bins) of `bins(t, rate)`; constant before their first sample."""
    away = back(signal.shape[1], _spectrum(signal, rate), response)
    return np.asarray(signal[:, :1] * response[:, :1].real + away)


def derivative_spectrum(signal: Array, rate: float) -> Complex:
    """Transform (n, bins) of the derivative of signals (n, t), see `_spectrum`."""
    frequencies = 2j * np.pi * bins(signal.shape[1], rate)
    return np.multiply(_spectrum(signal, rate), frequencies, dtype=np.complex128)


def _spectrum(signal: Array, rate: float) -> Complex:
    """Transform (n, bins) of signals (n, t) minus their first values.

    A signal is assumed constant before its first sample, so a start from standstill is exact. After its last sample it
    returns to the first value, so smoothly and slowly that the response to the end does not reach the start.
    """
    count = signal.shape[1]
    first, last = signal[:, :1], signal[:, -1:]
    away = np.subtract(signal, first)
    phase: Array = np.arange(1, count + 1, dtype=np.float64) * (np.pi / (count + 1))
    turning = (1 + np.cos(phase)) / 2
    after: Array = np.arange(1.0, count + 1) / (ENDING * rate)
    slope = np.multiply(np.subtract(last, signal[:, -2:-1]), ENDING * rate)
    fading = np.multiply(slope, np.multiply(after, np.exp(-after)))
    returning = np.add(np.multiply(np.subtract(last, first), turning), fading)
    extended = np.concatenate([away, returning], axis=1)
    return np.asarray(np.fft.rfft(extended, _padded(count)), dtype=np.complex128)


def back(count: int, spectrum: Complex, response: Complex) -> Array:
    """The signals (n, count) of a spectrum multiplied by a response."""
    return np.fft.irfft(spectrum * response, _padded(count))[:, :count].astype(np.float64, copy=False)


def bins(samples: int, rate: float) -> Array:
    """Frequencies, Hz, of `in_frequency`."""
    return np.fft.rfftfreq(_padded(samples), 1 / rate).astype(np.float64)


def _padded(samples: int) -> int:
    return next_fast_len(PADDED * samples, real=True)
