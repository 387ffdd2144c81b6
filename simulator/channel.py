"""One measured channel at the output of the drive: a delay, then first-order smoothing.

A delay between two steps is interpolated linearly: error at most 8e-4 of a line at 50 Hz.

Smoothing obeys ``T y' = u - y`` and is exact for a signal u that is linear between its steps h: with a =
exp(-h/T) and g = (1 - a) T/h, y[n] = a y[n-1] + (1 - g) u[n] + (g - a) u[n-1]. The response of the channel to a line
well below 1/h is therefore exp(-iw delay) / (1 + iwT), without a discretisation delay.
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
        self._part = part if part > 1e-9 else 0.0  # fraction of a step, added to the whole ones
        self._late = np.zeros((whole + bool(self._part), rows))
        self._smoothing = smoothing
        if smoothing:
            self._keep = math.exp(-step / smoothing)
            gain = (1 - self._keep) * smoothing / step
            self._now, self._before = 1 - gain, gain - self._keep
            self._state = np.zeros((1, rows))

    def restart(self, row: int, value: float) -> None:
        """The signal of the row was constant at `value`."""
        self._late[:, row] = value
        if self._smoothing:
            self._state[:, row] = (1 - self._now) * value

    def pass_on(self, signal: Array) -> Array:
        """Output for the input `signal` (steps, rows); the same shape."""
        if len(self._late):
            delayed = np.concatenate([self._late, signal])
            self._late = delayed[len(signal) :]
            older = delayed[: len(signal)]
            signal = older + (1 - self._part) * (delayed[1 : len(signal) + 1] - older) if self._part else older
        if self._smoothing:
            from scipy.signal import lfilter  # imported here, as it takes half a second and is rarely needed

            signal, self._state = lfilter([self._now, self._before], [1.0, -self._keep], signal, axis=0, zi=self._state)
        return signal
