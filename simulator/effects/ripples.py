"""Effects periodic in the motor angle: sums of ``amplitude sin(order * motor angle + phase)``."""

from collections.abc import Callable, Sequence
from math import sin

import numpy as np
from numpy.typing import NDArray

from simulator.moving_axis import MovingAxis
from simulator.scenario import GearError, Ripple

Array = NDArray[np.float64]


class Ripples:
    """One sum per row, as a function of the motor position (rows,) on the joint side, rad."""

    def __init__(self, axes: Sequence[MovingAxis], sums: Sequence[Sequence[Ripple | GearError]]) -> None:
        most = max(map(len, sums))
        self._order, self._amplitude, self._phase = np.zeros((3, most, len(axes)))
        for row, (axis, terms) in enumerate(zip(axes, sums, strict=True)):
            for k, term in enumerate(terms):
                self._order[k, row] = term.order * axis.gear_ratio
                self._amplitude[k, row] = term.amplitude
                self._phase[k, row] = term.phase

    def at(self, position: Array) -> Array:
        """The sums (..., rows) at positions (..., rows), in the unit of the amplitudes."""
        return (self._amplitude * np.sin(self._order * position[..., None, :] + self._phase)).sum(axis=-2)

    def alone(self, row: int) -> Callable[[float], float]:
        """The sum of one row, in floats."""
        terms = [part[:, row].tolist() for part in (self._amplitude, self._order, self._phase)]
        waves = list(zip(*terms, strict=True))
        return lambda position: sum([amplitude * sin(order * position + phase) for amplitude, order, phase in waves])

    def slope(self, position: Array) -> Array:
        """Their derivatives (..., rows) with respect to the joint angle."""
        waves = np.cos(self._order * position[..., None, :] + self._phase)
        return (self._amplitude * self._order * waves).sum(axis=-2)


class KnownRipples:
    """Ripples of a motor with prescribed motion, known for all steps; the user sets `step`."""

    def __init__(self, sums: Array, slopes: Array) -> None:
        """Both (steps, rows)."""
        self.step = 0
        self._sums, self._slopes = sums, slopes

    def at(self, position: Array) -> Array:
        """The sums (rows,) at the step."""
        return self._sums[self.step]

    def slope(self, position: Array) -> Array:
        """Their derivatives (rows,) at the step."""
        return self._slopes[self.step]


def cogging(axes: Sequence[MovingAxis]) -> Ripples | None:
    """Torque against the motor, N m; None if no row has cogging."""
    return Ripples(axes, [a.train.cogging for a in axes]) if any(a.train.cogging for a in axes) else None


def gear_error(axes: Sequence[MovingAxis]) -> Ripples | None:
    """Lead of the gear over its ratio, rad of the joint; None if no gear has an error."""
    return Ripples(axes, [a.train.gear_error for a in axes]) if any(a.train.gear_error for a in axes) else None
