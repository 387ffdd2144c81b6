r"""The path of a sweep: its velocity set-point integrated in closed form (paper, section 4.1).

Every part of the set-point (`excitation`) is c sin(w t + p), the offset with w = 0 and p = pi/2, times the envelope.
With k = pi / ramp and s the time since the start of the rise, the hold or the fall,

    rise   (1 - cos k s) / 2    hold   1    fall   (1 + cos k s) / 2
    cos(k s) sin(w s + p) = (sin((w + k) s + p) + sin((w - k) s + p)) / 2

so the only integral needed is  F(w, p, s) = int_0^s sin(w x + p) dx = s sin(p + w s / 2) sinc(w s / 2 pi),
which holds for every w, zero included.
"""

import numpy as np
from numpy.typing import NDArray

from service.identification.design.excitation import Excitation

Array = NDArray[np.float64]


def way(excitation: Excitation, time: Array) -> Array:
    """Position set-point relative to the start at `time` (n,), s from standstill; rad (m), exact. `ramp` is not 0."""
    hold = excitation.settle + excitation.periods * excitation.period
    rising = np.clip(time, 0.0, excitation.ramp)
    holding = np.clip(time - excitation.ramp, 0.0, hold)
    falling = np.clip(time - excitation.ramp - hold, 0.0, excitation.ramp)
    total = np.zeros_like(time)
    for amplitude, omega, phase in _parts(excitation):
        start = phase - omega * excitation.measure_from
        top = start + omega * excitation.ramp
        down = top + omega * hold
        total += amplitude * (
            _edge(omega, start, rising, np.pi / excitation.ramp, -1)
            + _integral(omega, top, holding)
            + _edge(omega, down, falling, np.pi / excitation.ramp, 1)
        )
    return total


def peak_jerk(excitation: Excitation) -> float:
    """Upper bound of the set-point's second derivative, rad/s^3 (m/s^3): product rule on envelope and waves."""
    bend = np.pi / excitation.ramp
    waves = [sum(abs(a) * omega**order for a, omega, _ in _parts(excitation)) for order in range(3)]
    return bend**2 / 2 * waves[0] + bend * waves[1] + waves[2]


def _parts(excitation: Excitation) -> list[tuple[float, float, float]]:
    """Amplitude, rad/s (m/s), angular frequency, rad/s, and phase at the window's start, rad, of every part."""
    offset = (excitation.offset_velocity, 0.0, np.pi / 2)
    return [offset, *((sine.amplitude, 2 * np.pi * sine.frequency, sine.phase) for sine in excitation.sines)]


def _edge(omega: float, phase: float, time: Array, bend: float, sign: int) -> Array:
    """The integral under (1 + sign cos(bend s)) / 2."""
    sides = _integral(omega + bend, phase, time) + _integral(omega - bend, phase, time)
    return _integral(omega, phase, time) / 2 + sign * sides / 4


def _integral(omega: float, phase: float, time: Array) -> Array:
    return time * np.sin(phase + omega * time / 2) * np.sinc(omega * time / (2 * np.pi))
