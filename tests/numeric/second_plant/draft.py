"""A machine while it is being drawn: effects change it, then it is stepped."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.numeric.second_plant.bodies import STANDARD, Curve, Rigid
from tests.numeric.second_plant.friction import Level, Now
from tests.numeric.second_plant.machine import Train
from tests.numeric.second_plant.plans import Motion, Plan
from tests.numeric.second_plant.robots import Mechanism
from tests.numeric.second_plant.sensors import Sensors

Array = NDArray[np.float64]

REACH = 0.45  # rad (m) about each pose: sweeps and what overshoots


@dataclass(frozen=True)
class Hidden:
    """What an effect leaves in the truth: its parameters, and effects that physically come with it."""

    parameters: dict[str, Any]
    companions: tuple[str, ...] = ()


@dataclass
class Draft:
    """One axis; N m, rad and kg m^2 on the joint side, whatever its kind."""

    random: np.random.Generator
    built: Mechanism
    index: int
    plan: Plan
    wanted: Motion
    rated: float
    ratio: float
    cogging_orders: tuple[float, ...]
    transmission_orders: tuple[float, ...]
    size: float  # N m that a hidden effect should make
    size_class: str
    motor: float  # kg m^2
    viscous: float  # N m s/rad
    nominal_viscous: float
    tight: bool
    sensors: Sensors
    tilted: tuple[float, float, float] = STANDARD
    train: Train = field(init=False)
    after: list[Callable[[Array, Array], Array]] = field(default_factory=list)  # (effort, position) -> effort told

    def __post_init__(self) -> None:
        poses = self.plan.poses
        self.train = Train(self.motor, np.zeros(len(poses)), *self._viscous(), self.curve(self.built))
        self.rebuild(self.built)

    @property
    def sweeps(self) -> int:
        return len(self.plan.specs)

    @property
    def slow(self) -> float:
        """Speed of the slow sweeps, rad/s."""
        return min(abs(spec.offset_velocity) for spec in self.plan.specs if spec.offset_velocity)

    @property
    def fastest(self) -> float:
        return float(np.abs(self.wanted.velocity).max())

    @property
    def starts(self) -> Array:
        return self.plan.poses[:, self.index]

    def curve(self, mechanism: Mechanism) -> Curve:
        """Holding torque of a mechanism along every sweep."""
        return Rigid(mechanism, self.tilted).curve(self.index, self.plan.poses, REACH)

    def rebuild(self, mechanism: Mechanism) -> None:
        """The same axis with other bodies."""
        rigid = Rigid(mechanism, self.tilted)
        poses = self.plan.poses
        self.built = mechanism
        self.train.load = np.array([rigid.inertia(self.index, pose) for pose in poses])
        self.train.gravity = self.curve(mechanism)

    def weight(self) -> float:
        """Largest holding torque on any sweep, N m."""
        return float(np.abs(self.train.gravity.at(self.starts)).max())

    def even(self, value: float) -> Array:
        return np.full(self.sweeps, value)

    def _viscous(self) -> tuple[Array, Array]:
        part = self.random.uniform(0.4, 0.8)
        return self.even(part * self.viscous), self.even((1 - part) * self.viscous)


def steady(level: Array) -> Level:
    """A level that nothing changes."""

    def of(now: Now) -> Array:
        return level

    return of
