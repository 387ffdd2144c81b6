"""Friction of motor and load that depends on speed, direction, load, position and temperature, and the heat it
generates.

    f(v) = b(v) thv |v| + th (Fc(v) + Fs exp(-|v/vs|^n) + c |v|^a + eta |Ts| + Fp patch(ql)),   against the motion
    C T' = sum f(v) v - C T / tau,      th = exp(-loss T), thv likewise

b and Fc may depend on the direction. All terms except the mean of the viscous part are the limit of the set-valued
law (`drive_train`), so each of them can hold an axis at standstill.
"""

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass
from math import sin
from typing import Protocol, cast

import numpy as np

from simulator.rigid_body import MovingAxis
from simulator.scenario import Appendage, Cogging, DriveTrain, Friction, GearError, LuGre, Strut
from simulator.waveform import Array


def viscous(friction: Friction) -> float:
    """Mean of both directions, N m s/rad."""
    backward = friction.viscous if friction.backward_viscous is None else friction.backward_viscous
    return (friction.viscous + backward) / 2


class FrictionAlone(Protocol):
    """`FrictionLaw` of one mass, in floats."""

    def limits(self, velocity: float, transmitted: float, load_position: float) -> tuple[float, float]: ...
    def beyond_mean(self, velocity: float) -> float: ...


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

    def alone(self, row: int) -> tuple[FrictionAlone, ...]:
        """Those of motor and load of one row, unless they warm."""
        arrays: dict[str, Array] = {name: part for name, part in vars(self).items() if isinstance(part, np.ndarray)}
        parts = {name: np.broadcast_to(part, self._forward.shape) for name, part in arrays.items()}
        both = copy(self), copy(self)
        for mass, law in enumerate(both):
            vars(law).update({name: float(part[mass, row]) for name, part in parts.items()})
        return cast("tuple[FrictionAlone, ...]", both)

    def limits(self, velocity: Array, transmitted: Array, load_position: Array) -> tuple[Array, Array]:
        """Dry friction (2, rows) N m against a motion forward and against one backward."""
        speed, rise = abs(velocity), 0.0 * self._forward
        if self._has_extra:
            rise = rise + self._extra * np.exp(-((speed / self._slow) ** self._bend))
        if self._has_load:
            rise = rise + self._load * abs(transmitted)
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
            return 0.0 * self._viscous
        differing = self._viscous * velocity + (self._viscous_forward - self._viscous) * abs(velocity)
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


class Counterbalances:
    """The torque of all counterbalances of many rows: -dE/dq of springs and gas between two points (virtual work)."""

    def __init__(self, rows: Sequence[Sequence[Strut]]) -> None:
        self._all = [(row, one) for row, some in enumerate(rows) for one in some]

    def torque(self, load: Array) -> Array:
        """Torque (..., rows), N m, that the drive must provide at the positions of the loads (..., rows)."""
        total = np.zeros_like(load)
        for row, one in self._all:
            angle = load[..., row] - one.zero
            across = one.crank * one.arm * np.sin(angle)
            square = one.apart**2 + one.crank**2 + one.arm**2 - 2 * one.crank * one.arm * np.cos(angle)
            length = np.sqrt(square)
            longer = length - one.length
            pull = one.force * (1.0 if one.column is None else (1 - longer / one.column) ** -one.exponent)
            total[..., row] += (pull + one.rate * longer) * across / length
        return total


class Bristles:
    """LuGre friction of the rows that have it; zero for the others. z is stepped implicitly: stable at any speed."""

    def __init__(self, rows: Sequence[LuGre | None], step: float) -> None:
        self._step = step
        self._stiffness = np.array([r.stiffness if r else 0.0 for r in rows])
        self._damping = np.array([r.damping if r else 0.0 for r in rows])
        self._coulomb = np.array([r.coulomb if r else 1.0 for r in rows])
        self._extra = np.array([r.breakaway - r.coulomb if r else 0.0 for r in rows])
        self._stribeck = np.array([r.stribeck_velocity if r else 1.0 for r in rows])
        self.deflection = np.zeros(len(rows))

    def alone(self, row: int) -> "Bristles":
        """Those of one row: every (rows,) is a number."""
        one = copy(self)
        vars(one).update({name: part[row] for name, part in vars(self).items() if isinstance(part, np.ndarray)})
        return one

    def step(self, velocity: Array) -> Array:
        """Friction torque (rows,), N m."""
        before = self.deflection
        self.deflection = (before + self._step * velocity) * self._kept(velocity)
        return self._torque(self.deflection, before)

    def along(self, velocity: Array) -> Array:
        """As `step`, for steps (steps, rows) that are known in advance."""
        kept, gained, path = self._kept(velocity), self._step * velocity, np.empty_like(velocity)
        now = before = self.deflection
        for n, (share, more) in enumerate(zip(kept, gained, strict=True)):
            path[n] = now = (now + more) * share
        self.deflection = now
        return self._torque(path, np.concatenate([before[None], path[:-1]]))

    def _kept(self, velocity: Array) -> Array:
        """Factor on the deflection in one step."""
        limit = self._coulomb + self._extra * np.exp(-((velocity / self._stribeck) ** 2))
        return 1 / (1 + self._step * self._stiffness * np.abs(velocity) / limit)

    def _torque(self, deflection: Array, before: Array) -> Array:
        return self._stiffness * deflection + self._damping / self._step * (deflection - before)


class Appendages:
    """``Ja va' = k (ql - qa) + d (vl - va)`` for the rows that have one; the torque acts on the load."""

    def __init__(self, rows: Sequence[Appendage | None], step: float) -> None:
        self._step = step
        self._inertia = np.array([r.inertia if r else 1.0 for r in rows])
        self._stiffness = np.array([r.stiffness if r else 0.0 for r in rows])
        self._damping = np.array([r.damping if r else 0.0 for r in rows])
        self.position = np.zeros(len(rows))
        self._velocity = np.zeros(len(rows))

    def settle(self, row: int, load_position: float) -> None:
        """At rest with the load."""
        self.position[row], self._velocity[row] = load_position, 0.0

    def step(self, load_position: Array, load_velocity: Array) -> Array:
        """Torque (rows,) N m from the load to the bodies."""
        torque = self._stiffness * (load_position - self.position) + self._damping * (load_velocity - self._velocity)
        self._velocity += self._step / self._inertia * torque
        self.position += self._step * self._velocity
        return torque


class Ripples:
    """One sum per row, as a function of the motor position (rows,) on the joint side, rad."""

    def __init__(self, axes: Sequence[MovingAxis], sums: Sequence[Sequence[Cogging | GearError]]) -> None:
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


@dataclass(frozen=True, slots=True)
class Turn:
    """One motion of an axis: start, s since the campaign start, sample interval, s, and speed (n,), rad/s."""

    started_at: float
    interval: float
    velocity: Array


def warmth(train: DriveTrain, turns: Sequence[Turn]) -> Array:
    """Temperature rise (m,) K at the start of each turn, from a cold start. Overlapping turns are put one after the
    other.

    The power of a turn is its mean at the temperature of its start, without load-dependent friction.
    """
    rises, warming = np.zeros(len(turns)), train.warming
    if warming is None:
        return rises
    rise = time = 0.0
    for number in sorted(range(len(turns)), key=lambda k: (turns[k].started_at, k)):
        turn = turns[number]
        rise *= np.exp(-max(turn.started_at - time, 0.0) / warming.time_constant)
        rises[number] = rise
        velocity, nothing = turn.velocity[None], np.zeros(1)
        power = float(np.mean(FrictionLaw([train], [rise], 0.0).power(velocity, nothing, nothing)))
        duration = len(turn.velocity) * turn.interval
        limit = power * warming.time_constant / warming.heat_capacity
        rise = limit + (rise - limit) * np.exp(-duration / warming.time_constant)
        time = max(turn.started_at, time) + duration
    return rises
