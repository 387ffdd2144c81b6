"""One step of the drive trains of `drive_train`, written once for two kinds of values.

Arrays (rows,) step many rows together. If few axes move, each is stepped alone in plain floats: one NumPy call on
three numbers costs more than ten float operations, and an axis with a closed brake then costs nothing.
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
    """A value of the motor, and [-1] of the load; in a rigid train both are the same."""

    def __getitem__(self, mass: int, /) -> Each: ...


@dataclass(frozen=True, slots=True)
class Arithmetic(Generic[Value]):
    """Functions with different names for floats and arrays."""

    sine: Callable[[Value], Value]
    within: Callable[[Value, Value, Value], Value]  # value, least, most
    other_than_zero: Callable[[Value], Value]  # 1.0 if it is not zero


def _within(value: float, least: float, most: float) -> float:
    return least if value < least else most if value > most else value


FLOATS: Arithmetic[float] = Arithmetic(math.sin, _within, lambda value: float(value != 0.0))
ARRAYS: Arithmetic[Array] = Arithmetic(
    np.sin,
    lambda value, least, most: np.minimum(np.maximum(value, least), most),
    lambda value: (value != 0.0).astype(float),
)


@dataclass(frozen=True, slots=True)
class ExtraFriction(Generic[Value]):
    """Friction in addition to Coulomb and viscous, motor first: maximum velocity changes in a step, and
    additional N m.
    """

    stick: Masses[Value]
    slip: Masses[Value]
    more: Masses[Value]


@dataclass(frozen=True, slots=True)
class Geared(Generic[Value]):
    """Present state of a gear with a transmission error."""

    ahead: Value  # rad of the joint
    lever: Value  # speed of the gear per rad/s of the motor
    drag: tuple[Value, Value]  # as in `Train`


@dataclass(frozen=True, slots=True, kw_only=True)
class Train(Generic[Value]):
    """Parameters of a step. Tuples hold motor and load, or the one mass of a rigid train; None: not present."""

    arithmetic: Arithmetic[Value]
    mobility: tuple[Value, ...]  # velocity change per N m in one step
    keep: tuple[Value, ...]  # factor on the velocity by viscous friction
    stick: tuple[Value, ...]  # maximum velocity change by Coulomb friction in a step
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
            if value is None or isinstance(value, Arithmetic):
                return value and FLOATS
            return tuple(map(of, cast(Any, value))) if isinstance(value, tuple) else float(value[row])

        return Train(**{field.name: of(getattr(self, field.name)) for field in fields(self)})

    def gravity(self, load: Value) -> Value:
        """Torque of gravity and hose on the load at its position, N m."""
        torque = self.gravity_amplitude * self.arithmetic.sine(load + self.gravity_phase) + self.gravity_constant
        return torque if self.hose is None else torque + self.hose * (load - self.hose_rest)

    def twist(self, motor: Value, load: Value, ahead: Value | None = None) -> Value:
        """Twist of the spring, rad: zero inside the backlash."""
        twist = motor - load
        if ahead is not None:
            twist = twist + ahead
        return twist if self.gap is None else twist - self.arithmetic.within(twist, -self.gap, self.gap)

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
        extra_friction: ExtraFriction[Value] | None = None,
    ) -> tuple[tuple[Value, ...], Value | None]:
        """Velocities of the masses half a step later, and the speed change of the load by the spring's damping (rigid:
        None).

        `motor`: torque available to the motor, N m; `appended`: torque of the load on an attached body.
        """
        motor_speed, load_speed = velocity[0], velocity[-1]
        gravity, within = self.gravity(position[-1]), self.arithmetic.within
        stick, slip = (self.stick, self.slip) if extra_friction is None else (extra_friction.stick, extra_friction.slip)
        if self.drag is None:
            force = motor - gravity
            if appended is not None:
                force = force - appended
            if extra_friction is not None:
                force = force - extra_friction.more[0]
            speed = motor_speed * self.keep[0] + force * self.mobility[0]
            return (speed - within(speed, slip[0], stick[0]),), None
        twist = self.twist(position[0], position[-1], None if geared is None else geared.ahead)
        spring = self.spring(twist)
        lever, drag = (None, self.drag) if geared is None else (geared.lever, geared.drag)
        drift = (motor_speed if lever is None else lever * motor_speed) - load_speed
        on_motor, on_load = motor - (spring if lever is None else lever * spring), spring - gravity
        if appended is not None:
            on_load = on_load - appended
        if extra_friction is not None:
            on_motor, on_load = on_motor - extra_friction.more[0], on_load - extra_friction.more[1]
        motor_speed = motor_speed * self.keep[0] + on_motor * self.mobility[0]
        load_speed = load_speed * self.keep[1] + on_load * self.mobility[1]
        drift = drift + (motor_speed if lever is None else lever * motor_speed) - load_speed
        if self.gap is not None:
            drift = drift * self.arithmetic.other_than_zero(twist)
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
        """Last step: speed change of the load by the spring's damping; speed of the load before the step."""
        self._train, self._step, self._cogging = train, step, cogging

    def step(self, effort: float) -> None:
        """Advance by one step with motor torque `effort`, N m."""
        motor = effort if self._cogging is None else effort - self._cogging(self.position[0])
        self.before = self.velocity[-1]
        self.velocity, damped = self._train.step(self.position, self.velocity, motor)
        self.damped = 0.0 if damped is None else damped
        self.position = tuple([q + self._step * v for q, v in zip(self.position, self.velocity, strict=True)])
