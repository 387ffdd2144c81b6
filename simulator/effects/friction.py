"""Friction of motor and load that depends on speed, direction, load, position and temperature, and the heat it
generates.

    f(v) = b(v) thv |v| + th (Fc(v) + Fs exp(-|v/vs|^n) + c |v|^a + eta |Ts| + Fp patch(ql)),   against the motion
    C T' = sum f(v) v - C T / tau,      th = exp(-loss T), thv likewise

b and Fc may depend on the direction. All terms except the mean of the viscous part are the limit of the set-valued
law (`drive_train`), so each of them can hold an axis at standstill.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from simulator.scenario import DriveTrain, Friction

Array = NDArray[np.float64]


def viscous(friction: Friction) -> float:
    """Mean of both directions, N m s/rad."""
    backward = friction.viscous if friction.backward_viscous is None else friction.backward_viscous
    return (friction.viscous + backward) / 2


class FrictionLaw:
    """Friction of many rows; arrays (2, rows) of motor and load. Velocities (1, rows) are those of a rigid train."""

    def __init__(self, trains: Sequence[DriveTrain], warmth: Sequence[float], step: float) -> None:
        both = [[train.motor_friction, train.load_friction] for train in trains]

        def of(values: Sequence[Sequence[float]]) -> Array:
            return np.array(values, dtype=float).reshape(-1, 2).T

        self._viscous = of([[viscous(f) for f in pair] for pair in both])
        self._viscous_forward = of([[f.viscous for f in pair] for pair in both])
        self._forward = of([[f.coulomb for f in pair] for pair in both])
        self._backward = of(
            [[f.coulomb if f.backward_coulomb is None else f.backward_coulomb for f in pair] for pair in both]
        )
        self._extra = of([[f.stribeck.extra if f.stribeck else 0.0 for f in pair] for pair in both])
        self._slow = of([[f.stribeck.velocity if f.stribeck else 1.0 for f in pair] for pair in both])
        self._bend = of([[f.stribeck.exponent if f.stribeck else 2.0 for f in pair] for pair in both])
        self._power = of([[f.power.coefficient if f.power else 0.0 for f in pair] for pair in both])
        self._exponent = of([[f.power.exponent if f.power else 1.0 for f in pair] for pair in both])
        self._load = of([[f.load_dependence for f in pair] for pair in both])
        self._patch = of([[f.patch.coulomb if f.patch else 0.0 for f in pair] for pair in both])
        self._centre = of([[f.patch.centre if f.patch else 0.0 for f in pair] for pair in both])
        self._width = of([[f.patch.width if f.patch else 1.0 for f in pair] for pair in both])
        self._has_extra, self._has_load = bool(self._extra.any()), bool(self._load.any())
        self._has_power, self._has_patch = bool(self._power.any()), bool(self._patch.any())
        self._differs = bool((self._viscous_forward != self._viscous).any())
        warming = [train.warming for train in trains]
        self.warms = any(warming)
        self.heating = step * np.array([1 / w.heat_capacity if w else 0.0 for w in warming])
        self.cooling = step * np.array([1 / w.time_constant if w else 0.0 for w in warming])
        self._coulomb_loss = np.array([w.coulomb_loss if w else 0.0 for w in warming])
        self._viscous_loss = np.array([w.viscous_loss if w else 0.0 for w in warming])
        self.warmth = np.array(warmth, dtype=float)
        """Temperature rise (rows,), K."""

    def limits(self, velocity: Array, transmitted: Array, load_position: Array) -> tuple[Array, Array]:
        """Dry friction (2, rows) N m against a motion forward and against one backward."""
        speed, rise = np.abs(velocity), np.zeros_like(self._forward)
        if self._has_extra:
            rise = rise + self._extra * np.exp(-((speed / self._slow) ** self._bend))
        if self._has_load:
            rise = rise + self._load * np.abs(transmitted)
        if self._has_power:
            rise = rise + self._power * speed**self._exponent
        if self._has_patch:
            away = np.minimum(np.abs(load_position - self._centre) / self._width, 1.0)
            rise = rise + self._patch * (1 + np.cos(np.pi * away)) / 2
        cold = np.exp(-self._coulomb_loss * self.warmth) if self.warms else 1.0
        return cold * (self._forward + rise), cold * (self._backward + rise)

    def beyond_mean(self, velocity: Array) -> Array:
        """Viscous friction (2, rows) N m in addition to that of `viscous`."""
        if not self._differs and not self.warms:
            return np.zeros_like(self._viscous)
        differing = self._viscous * velocity + (self._viscous_forward - self._viscous) * np.abs(velocity)
        return np.exp(-self._viscous_loss * self.warmth) * differing - self._viscous * velocity

    def torque(self, velocity: Array, transmitted: Array, load_position: Array) -> Array:
        """Friction (2, rows) N m against a motion, in addition to `viscous`; dry friction counts as zero at
        standstill.
        """
        forward, backward = self.limits(velocity, transmitted, load_position)
        dry = np.where(velocity > 0, forward, np.where(velocity < 0, -backward, 0.0))
        return dry + self.beyond_mean(velocity)

    def whole(self, velocity: Array, transmitted: Array, load_position: Array) -> Array:
        """Total friction (2, rows) N m against a motion; of (steps, 1, rows) each: (steps, 2, rows)."""
        return self.torque(velocity, transmitted, load_position) + self._viscous * velocity

    def power(self, velocity: Array, transmitted: Array, load_position: Array) -> Array:
        """Heat generated by all friction of a motion, (rows,) W."""
        return (self.whole(velocity, transmitted, load_position) * velocity).sum(axis=0)

    def warm(self, velocity: Array, transmitted: Array, load_position: Array) -> None:
        """One step of heating by this motion, and of cooling."""
        if self.warms:
            power = self.power(velocity, transmitted, load_position)
            self.warmth += self.heating * power - self.cooling * self.warmth


def friction_law(trains: Sequence[DriveTrain], warmth: Sequence[float], step: float) -> FrictionLaw | None:
    """None if there is only viscous and Coulomb friction."""
    plain = all(t.motor_friction.plain and t.load_friction.plain and t.warming is None for t in trains)
    return None if plain else FrictionLaw(trains, warmth, step)
