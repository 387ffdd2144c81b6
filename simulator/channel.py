"""One measured channel on its way out of the drive: a delay, then first-order smoothing.

A delay between two steps runs straight between their values: at most 8e-4 of a line at 50 Hz.

Smoothing obeys ``T y' = u - y``, taken exactly for a signal u that runs straight between its steps h: with a =
exp(-h/T) and g = (1 - a) T/h, y[n] = a y[n-1] + (1 - g) u[n] + (g - a) u[n-1]. So the channel's response to a line
well below 1/h is exp(-iw delay) / (1 + iwT), with no part of a step beside it.
"""

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Channel:
    """State of many rows; `delay` and `smoothing` (T) in s."""

    def __init__(self, rows: int, step: float, delay: float, smoothing: float) -> None:
        whole = math.floor(delay / step + 1e-9)
        part = delay / step - whole
        self._part = part if part > 1e-9 else 0.0  # of a step, on top of the whole ones
        self._late = np.zeros((whole + bool(self._part), rows))
        self._smoothing = smoothing
        if smoothing:
            self._keep = math.exp(-step / smoothing)
            gain = (1 - self._keep) * smoothing / step
            self._now, self._before = 1 - gain, gain - self._keep
            self._state = np.zeros((1, rows))

    def restart(self, row: int, value: float) -> None:
        """The row's signal was `value` for long."""
        self._late[:, row] = value
        if self._smoothing:
            self._state[:, row] = (1 - self._now) * value

    def pass_on(self, signal: Array) -> Array:
        """What comes out while `signal` (steps, rows) goes in; the same shape."""
        if len(self._late):
            delayed = np.concatenate([self._late, signal])
            self._late = delayed[len(signal) :]
            older = delayed[: len(signal)]
            signal = older + (1 - self._part) * (delayed[1 : len(signal) + 1] - older) if self._part else older
        if self._smoothing:
            from scipy.signal import lfilter  # half a second that a machine without smoothing need not wait for

            signal, self._state = lfilter([self._now, self._before], [1.0, -self._keep], signal, axis=0, zi=self._state)
        return signal
