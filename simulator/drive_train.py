"""Drive trains, one row each, stepped together: motor and load with a spring between them, or one rigid mass.

    Jm vm' = u - (1 + g') Ts - fm(vm) - cogging(qm)     Ts = k e + k3 e^3 + d e',  e = qm + g(qm) - ql, less backlash
    Jl vl' = Ts - fl(vl) - gravity(ql) - hose(ql, vl) - counterbalance(ql)
    f(v) = mu v + Fc sign(v); more of it in `effects.friction`

Leapfrog: positions and effort at the steps n, velocities half-way between, so effort u_n, position q_n and velocity
(v_{n-1/2} + v_{n+1/2})/2 belong to one instant to second order. Viscous and structural damping are trapezoidal. Coulomb
friction is the exact solution of the set-valued law over a step, v <- v - clip(v, -c, c): it sticks and never chatters.
A rigid mass thus obeys Gamma/Omega = (2J/h) i tan(wh/2) + mu, 5e-6 from iwJ at 5 Hz and h = 0.25 ms.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any, Generic, Protocol, TypeVar, cast

import numpy as np

from simulator.effects import (
    Appendages,
    Bristles,
    Counterbalances,
    FrictionAlone,
    KnownRipples,
    Ripples,
    cogging,
    friction_law,
    gear_error,
    viscous,
)
from simulator.rigid_body import MovingAxis
from simulator.waveform import Array

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

        `motor`: torque available to the motor, N m; `appended`: torque of the load on what is attached to it.
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


@dataclass(slots=True, kw_only=True)
class TrainAlone:
    """One row with an open brake, stepped in floats: `position` and `velocity` of its masses."""

    position: tuple[float, ...]
    velocity: tuple[float, ...]
    before: float  # speed of the load before the last step
    bristles: Bristles | None
    friction: Sequence[FrictionAlone] | None
    damped: float = 0.0  # speed change of the load by the spring's damping in the last step
    free: float = 1.0
    _train: Train[float]
    _step: float
    _load_inertia: float
    _cogging: Callable[[float], float] | None

    def step(self, effort: float) -> None:
        """Advance by one step with motor torque `effort`, N m."""
        motor = effort if self._cogging is None else effort - self._cogging(self.position[0])
        if self.bristles is not None:
            motor -= float(self.bristles.step(np.asarray(self.velocity[0])))
        extra = None if self.friction is None else self._rubbed(self.friction)
        self.before = self.velocity[-1]
        self.velocity, damped = self._train.step(self.position, self.velocity, motor, extra_friction=extra)
        self.damped = 0.0 if damped is None else damped
        self.position = tuple([q + self._step * v for q, v in zip(self.position, self.velocity, strict=True)])

    def _rubbed(self, friction: Sequence[FrictionAlone]) -> ExtraFriction[float]:
        transmitted, load, masses = self._transmitted(), self.position[-1], self._train.mobility
        speeds = self.velocity if len(self.velocity) > 1 else self.velocity * 2  # a rigid train has both frictions
        limits = [law.limits(speed, transmitted, load) for law, speed in zip(friction, speeds, strict=True)]
        more = [law.beyond_mean(speed) for law, speed in zip(friction, speeds, strict=True)]
        forward, backward = zip(*limits, strict=True)
        if len(masses) == 1:
            forward, backward, more = [sum(forward)], [sum(backward)], [sum(more)]
        return ExtraFriction(
            [mobility * limit for mobility, limit in zip(masses, forward, strict=True)],
            [-mobility * limit for mobility, limit in zip(masses, backward, strict=True)],
            more,
        )

    def _transmitted(self) -> float:
        """As `DriveTrains.transmitted`."""
        if self._train.drag is not None:
            return self._train.spring(self._train.twist(*self.position))
        return (
            self._train.gravity(self.position[0]) + self._load_inertia * (self.velocity[0] - self.before) / self._step
        )


class DriveTrains:
    """State and one step of many rows. `position` and `velocity` are (masses, rows): motor first, load last."""

    few = 5
    """Up to this number of rows, stepping them one by one is faster."""

    def __init__(self, axes: Sequence[MovingAxis], step: float) -> None:
        trains = [axis.train for axis in axes]
        springs = [train.spring for train in trains if train.spring is not None]
        if 0 < len(springs) < len(trains):
            raise ValueError("rigid and elastic drive trains cannot share a batch")
        self.elastic = bool(springs)
        rows, masses = len(axes), 2 if self.elastic else 1
        self.position = np.zeros((masses, rows))
        self.velocity = np.zeros((masses, rows))
        self.free = np.zeros(rows)  # 1 where the brake is open
        self._damped = np.zeros(rows)  # speed change of the load by the spring's damping in the last step
        self._step = step

        self._stiffness = np.array([spring.stiffness for spring in springs])
        self._hardening = np.array([spring.hardening for spring in springs])
        self.damping = np.array([spring.damping for spring in springs])
        self._gap = np.array([spring.backlash / 2 for spring in springs])
        self._has_gap = bool(self._gap.any())
        hoses = [train.hose for train in trains]
        self._hose = np.array([hose.stiffness if hose else 0.0 for hose in hoses])
        self._hose_rest = np.array([hose.rest if hose else 0.0 for hose in hoses])
        self._has_hose = any(hoses)
        on_load = [viscous(t.load_friction) + (t.hose.damping if t.hose else 0.0) for t in trains]
        on_motor = [viscous(train.motor_friction) for train in trains]
        coulomb = np.array([[train.motor_friction.coulomb, train.load_friction.coulomb] for train in trains]).T
        self._viscous, self._coulomb = self._masses(np.array([on_motor, on_load])), self._masses(coulomb)
        self.friction = friction_law(trains, [axis.warmth for axis in axes], step)
        self._cogging = cogging(axes)
        self.gear_error: Ripples | KnownRipples | None = gear_error(axes)
        self._bristles = Bristles([t.lugre for t in trains], step) if any(t.lugre for t in trains) else None
        appendages = [train.appendage for train in trains]
        self.appendages = Appendages(appendages, step) if any(appendages) else None
        balances = [train.counterbalance for train in trains]
        self._balance = Counterbalances(balances) if any(balances) else None
        self._is_pulled = self._has_hose or self._balance is not None
        self._earlier = np.zeros(rows)  # speed of the load one step before, used by friction
        self.load(axes)

    def load(self, axes: Sequence[MovingAxis]) -> None:
        """Set inertia and gravity of another pose; the drive trains and their state are kept."""
        self._load_inertia = np.array([axis.load_inertia for axis in axes])
        inertia = self._masses(np.array([[axis.motor_inertia for axis in axes], self._load_inertia]))
        half = self._step * self._viscous / 2
        self._mobility = self._step / (inertia + half)  # velocity change per N m in one step
        self._stick = self._mobility * self._coulomb
        gravity = [axis.gravity for axis in axes]
        self._each: dict[int, Train[float]] = {}  # single rows in floats, created on request
        self._train = Train(
            arithmetic=ARRAYS,
            mobility=tuple(self._mobility),
            keep=tuple((inertia - half) / (inertia + half)),
            stick=tuple(self._stick),
            slip=tuple(-self._stick),
            drag=self._dragged(np.ones(len(axes))) if self.elastic else None,
            stiffness=self._stiffness if self.elastic else np.zeros(len(axes)),
            hardening=self._hardening if self._hardening.any() else None,
            gap=self._gap if self._has_gap else None,
            hose=self._hose if self._has_hose else None,
            hose_rest=self._hose_rest,
            gravity_amplitude=np.array([np.hypot(g.cosine, g.sine) for g in gravity]),
            gravity_phase=np.array([np.arctan2(g.cosine, g.sine) for g in gravity]),
            gravity_constant=np.array([g.constant for g in gravity]),
        )

    def _masses(self, values: Array) -> Array:
        """(motor and load, rows) -> one row of values for each mass."""
        return values if self.elastic else values.sum(axis=0, keepdims=True)

    def _dragged(self, lever: Array) -> tuple[Array, Array]:
        """Speed, (rows,) each, that the motor loses and the load gains per sum of old and new speed of the spring."""
        drag, motor, load = self.damping / 2, lever * self._mobility[0], self._mobility[1]
        impulse = drag / (1 + drag * (lever * motor + load))
        return motor * impulse, -load * impulse

    def gravity(self) -> Array:
        """Torque of gravity, hose and counterbalance on the load at its present position, (rows,) N m."""
        load = self.position[-1]
        return self._train.gravity(load) + (0.0 if self._balance is None else self._balance.torque(load))

    def holding_torque(self) -> Array:
        """Torque to hold the loads at their positions, (rows,) N m."""
        return self.gravity()

    def spring_load(self) -> Array:
        """Torque (rows,) N m of hoses and counterbalances on the loads."""
        torque = self._hose * (self.position[-1] - self._hose_rest)
        return torque if self._balance is None else torque + self._balance.torque(self.position[-1])

    def twist(self) -> Array:
        """Twist of the springs, rad (rows,): zero inside the backlash."""
        ahead = None if self.gear_error is None else self.gear_error.at(self.position[0])
        return self._train.twist(self.position[0], self.position[1], ahead)

    def engaged(self) -> Array:
        """1.0 if the teeth are in contact, (rows,)."""
        return (self.twist() != 0.0).astype(float) if self._has_gap else np.ones(len(self.free))

    def spring_torque(self) -> Array:
        """Torque of the springs without their damping, (rows,) N m."""
        return self._train.spring(self.twist())

    def damping_torque(self) -> Array:
        """Torque (rows,) N m of the springs' damping on the load in the last step."""
        return -self._damped / self._mobility[1]

    def lever(self) -> Array:
        """Speed of the gear per rad/s of the motor, (rows,); its torque acts on the motor multiplied by this ratio."""
        return 1 + (np.zeros(len(self.free)) if self.gear_error is None else self.gear_error.slope(self.position[0]))

    def transmitted(self) -> Array:
        """Torque (rows,) N m from gear to load; in a rigid train from the acceleration of the last step."""
        if self.elastic:
            return self.spring_torque()
        return self.gravity() + self._load_inertia * (self.velocity[-1] - self._earlier) / self._step

    def settle(self, row: int) -> float:
        """Put the load of a standing row where the spring balances gravity. Returns the required motor torque, N m."""
        self.velocity[:, row] = self._earlier[row] = 0.0
        if self._bristles is not None:
            self._bristles.deflection[row] = 0.0
        if self.elastic:
            ahead = 0.0 if self.gear_error is None else float(self.gear_error.at(self.position[0])[row])
            twist = 0.0
            for _ in range(30):  # converges by gravity stiffness / spring stiffness, about 1e-2 per iteration
                flank = np.sign(twist) * self._gap[row]
                self.position[1, row] = self.position[0, row] + ahead - twist - flank
                twist = self.holding_torque()[row] / (self._stiffness[row] + self._hardening[row] * twist**2)
        if self.appendages is not None:
            self.appendages.settle(row, float(self.position[-1, row]))
        return float((self.lever() * self.holding_torque())[row])

    def step(self, effort: Array) -> None:
        """Advance every row by one step under motor torque `effort` (rows,), N m."""
        position, velocity = self.position, self.velocity
        motor, geared, appended, extra_friction = self.motor_torque(effort), self._geared(), None, None
        if self.appendages is not None:
            appended = self.appendages.step(position[-1], velocity[-1])
        if self._balance is not None:
            appended = self._balance.torque(position[-1]) + (0.0 if appended is None else appended)
        if self.friction is not None:
            forward, backward, more = self.rub()
            extra_friction = ExtraFriction(self._mobility * forward, -self._mobility * backward, more)
        masses, damped = self._train.step(position, velocity, motor, geared, appended, extra_friction)
        if damped is not None:
            self._damped = damped
        for mass, speed in enumerate(masses):
            np.multiply(speed, self.free, out=velocity[mass])
        position += self._step * velocity

    def _geared(self) -> Geared[Array] | None:
        """Present state of the gears, if any gear has a transmission error."""
        if self.gear_error is None:
            return None
        lever = self.lever()
        return Geared(self.gear_error.at(self.position[0]), lever, self._dragged(lever))

    def alone(self) -> dict[int, TrainAlone] | None:
        """The rows with an open brake, each to be stepped alone and then taken back; None if this is not
        possible now.
        """
        together = (self.gear_error, self.appendages, self._balance)
        warms = self.friction is not None and self.friction.warms
        free = np.flatnonzero(self.free).tolist()
        if len(free) > self.few or warms or any(effect is not None for effect in together):
            return None
        self._each |= {row: self._train.alone(row) for row in free if row not in self._each}
        return {
            row: TrainAlone(
                position=tuple(self.position[:, row].tolist()),
                velocity=tuple(self.velocity[:, row].tolist()),
                before=float(self._earlier[row]),
                bristles=None if self._bristles is None else self._bristles.alone(row),
                friction=None if self.friction is None else self.friction.alone(row),
                _train=self._each[row],
                _step=self._step,
                _load_inertia=float(self._load_inertia[row]),
                _cogging=None if self._cogging is None else self._cogging.alone(row),
            )
            for row in free
        }

    def take_back(self, row: int, alone: TrainAlone) -> None:
        """Take the state of a row that was stepped alone."""
        self.position[:, row], self.velocity[:, row], self._damped[row] = alone.position, alone.velocity, alone.damped
        self._earlier[row] = alone.before
        if self._bristles is not None and alone.bristles is not None:
            self._bristles.deflection[row] = alone.bristles.deflection

    def motor_torque(self, effort: Array) -> Array:
        """`effort` (rows,) N m minus cogging and presliding friction."""
        if self._cogging is not None:
            effort = effort - self._cogging.at(self.position[0])
        return effort if self._bristles is None else effort - self._bristles.step(self.velocity[0])

    def friction_torque(self, transmitted: Array) -> Array:
        """Friction (masses, rows) N m against the present motion; dry friction counts as zero at standstill."""
        if self.friction is None:
            return self._viscous * self.velocity + self._coulomb * np.sign(self.velocity)
        more = self.friction.torque(self.velocity, transmitted, self.position[-1])
        return self._viscous * self.velocity + self._masses(more)

    def rub(self) -> tuple[Array, Array, Array]:
        """A step of `friction`: dry forward, dry backward, and viscous beyond its mean, each (masses, rows) N m."""
        if self.friction is None:
            raise ValueError("every row has plain friction")
        motion = (self.velocity, self.transmitted(), self.position[-1])
        forward, backward = self.friction.limits(*motion)
        more = self.friction.beyond_mean(self.velocity)
        self.friction.warm(*motion)
        self._earlier = self.velocity[-1].copy()
        return self._masses(forward), self._masses(backward), self._masses(more)
