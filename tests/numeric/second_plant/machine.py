"""One axis in closed loop, all sweeps of a case side by side, stepped with NumPy at 4 kHz.

Rigid gear, with M = Jm + J and q both motor and load:  M dv/dt = u - g(q) - b v - F - (other forces).
Elastic gear, motor q and load p:  Jm dv/dt = u - S(q - p) - bm v - F - ...,  J dw/dt = S(q - p) - g(p) - bl w - ...

Drift half a step, kick, drift half a step (leapfrog, of second order); viscous terms by the trapezoid rule, sticking
friction by one linearised implicit step. The torque u is held over a step, so its value *at* an instant, where position
and speed are sampled, is the mean of the two steps that meet there: anything else would hide a delay in every record.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tests.numeric.second_plant.bodies import Curve
from tests.numeric.second_plant.friction import Now, Sticking
from tests.numeric.second_plant.plans import Motion

Array = NDArray[np.float64]

STEP = 1.0 / 4000.0  # s


class Force(Protocol):
    """Anything that the drive must overcome on its side of the gear."""

    def torque(self, now: Now) -> Array:
        """N m (N), (m,)."""
        ...


@dataclass(frozen=True)
class Spring:
    """Between motor and load: k x (1 + (x / hard)^2) + d dx/dt beyond a play of `play` on either side; SI."""

    stiffness: Array  # (m,) or (1,)
    damping: Array
    hard: float = np.inf  # rad, twist at which the stiffness term has doubled
    play: float = 0.0  # rad

    def torque(self, twist: Array, rate: Array) -> Array:
        beyond = twist - np.clip(twist, -self.play, self.play)
        touching = beyond != 0.0 if self.play else 1.0
        force = self.stiffness * beyond * (1.0 + np.square(beyond / self.hard)) + touching * self.damping * rate
        if not self.play:
            return force
        return np.where(beyond > 0, np.maximum(force, 0.0), np.minimum(force, 0.0))  # flanks push, they do not pull

    def twist(self, torque: Array) -> Array:
        """That carries a torque at rest, by Newton's iteration."""
        x = torque / self.stiffness
        for _ in range(30):
            u2 = np.square(x / self.hard)
            x = x - (self.stiffness * x * (1.0 + u2) - torque) / (self.stiffness * (1.0 + 3.0 * u2))
        return x + np.sign(torque) * self.play


@dataclass
class Train:
    """Everything mechanical about the axis that moves; arrays (m,) one value a sweep."""

    motor: float  # kg m^2 on the joint side
    load: Array
    viscous_motor: Array
    viscous_load: Array
    gravity: Curve
    on_motor: list[Force] = field(default_factory=list)
    on_load: list[Force] = field(default_factory=list)
    dry: list[Sticking] = field(default_factory=list)
    dry_on_load: list[Sticking] = field(default_factory=list)  # behind the spring
    spring: Spring | None = None
    delivered: Callable[[Now], Array] | None = None  # share of the torque asked for that arrives


@dataclass(frozen=True)
class Controls:
    """Position, speed (PI) and feed-forward of a cascade; joint side."""

    speed: float  # N m s/rad
    reset: float  # 1/s
    position: float  # 1/s
    inertia: float  # kg m^2, fed forward
    viscous: float  # N m s/rad, fed forward
    limit: float  # N m


@dataclass(frozen=True)
class Raw:
    """True values at every step, (steps, m): torque asked for, speed and position of motor and load."""

    torque: Array
    velocity: Array
    position: Array
    load_position: Array


def run(train: Train, controls: Controls, starts: Array, wanted: Motion, feedback_noise: Array) -> Raw:
    """All sweeps from standstill; `starts` (m,) positions, `feedback_noise` (steps, m) rad/s in the speed loop."""
    steps, count = wanted.velocity.shape
    torque, velocity, position, load_position = (np.empty((steps, count)) for _ in range(4))
    forward = controls.inertia * wanted.acceleration + controls.viscous * wanted.velocity
    goal = wanted.velocity + controls.position * wanted.position - feedback_noise
    zero = np.zeros(count)
    now = Now(STEP, 0.0, starts, zero, zero, zero, zero)
    now.load = train.gravity.at(starts) + _sum(train.on_load, now)  # all that a spring carries at standstill
    motor = _Side(starts + (train.spring.twist(now.load) if train.spring else 0.0), zero, zero)
    now.position = motor.position
    now.drive = held = now.load + _sum(train.on_motor, now)
    load = _Side(starts.copy(), zero, zero) if train.spring else motor
    integral, origin = held.copy(), motor.position
    reset = STEP * controls.reset * controls.speed
    for n in range(steps):
        error = goal[n] - controls.position * (motor.position - origin) - motor.velocity
        integral = integral + reset * error
        asked = forward[n] + controls.speed * error + integral
        asked = np.minimum(np.maximum(asked, -controls.limit), controls.limit)
        torque[n], velocity[n] = asked, motor.velocity
        position[n], load_position[n] = motor.position, load.position
        now.time, now.drive = n * STEP, asked
        if train.spring is None:
            _rigid_step(train, now, motor)
        else:
            _elastic_step(train, train.spring, now, motor, load)
    return Raw(_at_instants(torque), velocity, position, load_position)


@dataclass
class _Side:
    position: Array
    velocity: Array
    change: Array  # of the speed in the step before

    def place(self, now: Now) -> None:
        """Look at the middle of the step."""
        now.position = self.position + STEP / 2 * self.velocity
        now.velocity = self.velocity + 0.5 * self.change
        now.acceleration = self.change / STEP

    def go(self, middle: Array, push: Array, inertia: Array | float, resists: Array | float) -> None:
        self.change = STEP * push / (inertia + STEP * resists)
        self.velocity = self.velocity + self.change
        self.position = middle + STEP / 2 * self.velocity


def _rigid_step(train: Train, now: Now, side: _Side) -> None:
    side.place(now)
    middle = now.position
    weight = train.gravity.at(middle)
    pulled = _sum(train.on_load, now)
    now.load = weight + pulled + train.load * now.acceleration
    viscous = train.viscous_motor + train.viscous_load
    push = _arriving(train, now) - weight - viscous * side.velocity - pulled
    push = push - _sum(train.on_motor, now)
    dry, stiff = _dry(train.dry, now, side.velocity)
    side.go(middle, push - dry, train.motor + train.load, stiff + 0.5 * viscous)
    _moved(train.dry, now, side.velocity)


def _elastic_step(train: Train, spring: Spring, now: Now, motor: _Side, load: _Side) -> None:
    load.place(now)
    bottom, speed = now.position, now.velocity
    resisted = train.gravity.at(bottom) + train.viscous_load * load.velocity + _sum(train.on_load, now)
    motor.place(now)
    middle = now.position
    carried = spring.torque(middle - bottom, now.velocity - speed)
    now.load = carried
    push = _arriving(train, now) - carried - train.viscous_motor * motor.velocity - _sum(train.on_motor, now)
    dry, stiff = _dry(train.dry, now, motor.velocity)
    motor.go(middle, push - dry, train.motor, stiff + 0.5 * train.viscous_motor)
    _moved(train.dry, now, motor.velocity)
    dry, stiff = _dry(train.dry_on_load, now, load.velocity)
    load.go(bottom, carried - resisted - dry, train.load, stiff + 0.5 * train.viscous_load)
    _moved(train.dry_on_load, now, load.velocity)


def _arriving(train: Train, now: Now) -> Array:
    return now.drive if train.delivered is None else train.delivered(now) * now.drive


def _sum(forces: Sequence[Force], now: Now) -> Array | float:
    total: Array | float = 0.0
    for force in forces:
        total = total + force.torque(now)
    return total


def _dry(parts: Sequence[Sticking], now: Now, velocity: Array) -> tuple[Array | float, Array | float]:
    force: Array | float = 0.0
    stiff: Array | float = 0.0
    for part in parts:
        one, by_speed = part.opposes(now, velocity)
        force, stiff = force + one, stiff + by_speed
    return force, stiff


def _moved(parts: Sequence[Sticking], now: Now, velocity: Array) -> None:
    for part in parts:
        part.moved(now, velocity)


def _at_instants(held: Array) -> Array:
    """Values held over steps, as seen at the instants between them; the first stays."""
    result = held.copy()
    result[1:] = (held[1:] + held[:-1]) / 2
    return result
