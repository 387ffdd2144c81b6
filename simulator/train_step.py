"""One step of the drive trains of `drive_train`, written once for two kinds of values.

Arrays (rows,) step many rows together. Where few axes move, each is stepped alone in plain floats: one call of NumPy on
three numbers costs more than ten operations on floats, and then a closed brake costs nothing.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any, Generic, Protocol, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Value = TypeVar("Value", float, Array)
Each = TypeVar("Each", float, Array, covariant=True)


class Masses(Protocol[Each]):
    """A value of the motor, and [-1] one of the load; of a rigid train both are the same."""

    def __getitem__(self, mass: int, /) -> Each: ...


@dataclass(frozen=True, slots=True)
class Reckoning(Generic[Value]):
    """What floats and arrays call by different names."""

    sine: Callable[[Value], Value]
    within: Callable[[Value, Value, Value], Value]  # value, least, most
    other_than_zero: Callable[[Value], Value]  # 1.0 where it is


def _within(value: float, least: float, most: float) -> float:
    return least if value < least else most if value > most else value


FLOATS: Reckoning[float] = Reckoning(math.sin, _within, lambda value: float(value != 0.0))
ARRAYS: Reckoning[Array] = Reckoning(
    np.sin,
    lambda value, least, most: np.minimum(np.maximum(value, least), most),
    lambda value: (value != 0.0).astype(float),
)


@dataclass(frozen=True, slots=True)
class Rubbing(Generic[Value]):
    """Friction beyond plain Coulomb and viscous, motor first: velocities it can take in a step, and N m beside."""

    stick: Masses[Value]
    slip: Masses[Value]
    more: Masses[Value]


@dataclass(frozen=True, slots=True)
class Geared(Generic[Value]):
    """A gear that does not turn true, at this instant."""

    ahead: Value  # rad of the joint
    lever: Value  # how fast the gear turns for each rad/s of the motor
    drag: tuple[Value, Value]  # as in `Train`


@dataclass(frozen=True, slots=True, kw_only=True)
class Train(Generic[Value]):
    """What a step needs to know. Tuples hold motor and load, or the one mass of a rigid train; None: there is none."""

    reckoning: Reckoning[Value]
    mobility: tuple[Value, ...]  # velocity gained per N m in one step
    keep: tuple[Value, ...]  # share of the velocity that viscous friction leaves
    stick: tuple[Value, ...]  # velocity that Coulomb friction can take in a step
    slip: tuple[Value, ...]  # its negative
    drag: tuple[Value, Value] | None  # speed lost to the spring's damping per sum of its old and new; None: rigid
    stiffness: Value
    hardening: Value | None
    gap: Value | None  # half the backlash
    hose: Value | None
    hose_rest: Value
    gravity_amplitude: Value
    gravity_phase: Value
    gravity_constant: Value

    def alone(self: "Train[Array]", row: int) -> "Train[float]":
        """One row of many, in floats."""

        def of(value: Any) -> Any:
            if value is None or isinstance(value, Reckoning):
                return value and FLOATS
            return tuple(map(of, cast(Any, value))) if isinstance(value, tuple) else float(value[row])

        return Train(**{field.name: of(getattr(self, field.name)) for field in fields(self)})

    def gravity(self, load: Value) -> Value:
        """Torque of gravity and hose on the load at its position, N m."""
        torque = self.gravity_amplitude * self.reckoning.sine(load + self.gravity_phase) + self.gravity_constant
        return torque if self.hose is None else torque + self.hose * (load - self.hose_rest)

    def twist(self, motor: Value, load: Value, ahead: Value | None = None) -> Value:
        """How far the spring is wound, rad: nothing while the teeth are off both flanks."""
        twist = motor - load
        if ahead is not None:
            twist = twist + ahead
        return twist if self.gap is None else twist - self.reckoning.within(twist, -self.gap, self.gap)

    def spring(self, twist: Value) -> Value:
        """Torque of the spring alone, without its damping, N m."""
        return (self.stiffness if self.hardening is None else self.stiffness + self.hardening * (twist * twist)) * twist

    def step(
        self,
        position: Masses[Value],
        velocity: Masses[Value],
        motor: Value,
        geared: Geared[Value] | None = None,
        appended: Value | None = None,
        rubbing: Rubbing[Value] | None = None,
    ) -> tuple[tuple[Value, ...], Value | None]:
        """Velocities of the masses half a step on, and what of the load's the spring's damping took (rigid: None).

        `motor`: torque left to the motor, N m; `appended`: what the load gives to what hangs at it.
        """
        motor_speed, load_speed = velocity[0], velocity[-1]
        gravity, within = self.gravity(position[-1]), self.reckoning.within
        stick, slip = (self.stick, self.slip) if rubbing is None else (rubbing.stick, rubbing.slip)
        if self.drag is None:
            force = motor - gravity
            if appended is not None:
                force = force - appended
            if rubbing is not None:
                force = force - rubbing.more[0]
            speed = motor_speed * self.keep[0] + force * self.mobility[0]
            return (speed - within(speed, slip[0], stick[0]),), None
        twist = self.twist(position[0], position[-1], None if geared is None else geared.ahead)
        spring = self.spring(twist)
        lever, drag = (None, self.drag) if geared is None else (geared.lever, geared.drag)
        drift = (motor_speed if lever is None else lever * motor_speed) - load_speed
        on_motor, on_load = motor - (spring if lever is None else lever * spring), spring - gravity
        if appended is not None:
            on_load = on_load - appended
        if rubbing is not None:
            on_motor, on_load = on_motor - rubbing.more[0], on_load - rubbing.more[1]
        motor_speed = motor_speed * self.keep[0] + on_motor * self.mobility[0]
        load_speed = load_speed * self.keep[1] + on_load * self.mobility[1]
        drift = drift + (motor_speed if lever is None else lever * motor_speed) - load_speed
        if self.gap is not None:
            drift = drift * self.reckoning.other_than_zero(twist)
        damped = drag[1] * drift
        motor_speed = motor_speed - drag[0] * drift
        load_speed = load_speed - damped
        motor_speed = motor_speed - within(motor_speed, slip[0], stick[0])
        return (motor_speed, load_speed - within(load_speed, slip[1], stick[1])), damped


class TrainAlone:
    """One row with an open brake, stepped in floats: `position` and `velocity` of its masses."""

    free = 1.0

    def __init__(
        self,
        train: Train[float],
        step: float,
        position: tuple[float, ...],
        velocity: tuple[float, ...],
        cogging: Callable[[float], float] | None,
    ) -> None:
        self.position, self.velocity = position, velocity
        self.damped, self.before = 0.0, velocity[-1]
        """Of the last step: what the spring's damping took from the load's speed; that speed before it."""
        self._train, self._step, self._cogging = train, step, cogging

    def step(self, effort: float) -> None:
        """Advance by one step under motor torque `effort`, N m."""
        motor = effort if self._cogging is None else effort - self._cogging(self.position[0])
        self.before = self.velocity[-1]
        self.velocity, damped = self._train.step(self.position, self.velocity, motor)
        self.damped = 0.0 if damped is None else damped
        self.position = tuple([q + self._step * v for q, v in zip(self.position, self.velocity, strict=True)])
