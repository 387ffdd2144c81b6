"""A machine while it is being drawn: effects change it, then it is stepped."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.model.counterbalance import Counterbalance
from tests.numeric.second_plant.bodies import STANDARD, Curve, Rigid
from tests.numeric.second_plant.friction import Level, Now
from tests.numeric.second_plant.machine import Train
from tests.numeric.second_plant.plans import Motion, Plan, Random
from tests.numeric.second_plant.robots import Body, Mechanism, joined
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

    random: Random
    later: Random  # of what is drawn for sweeps that came later
    drawn: int  # sweeps that the machine was drawn for: the first ones
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
    carried: tuple[Body | None, ...]  # a value a sweep: what was bolted to the flange
    tilted: tuple[float, float, float] = STANDARD
    on_paper: Counterbalance | None = None
    train: Train = field(init=False)
    after: list[Callable[[Array, Array], Array]] = field(default_factory=list)  # (effort, position) -> effort told

    def __post_init__(self) -> None:
        poses = self.plan.poses
        self.train = Train(self.motor, np.zeros(len(poses)), *self._viscous(), self.curve(self.built))
        self.rebuild(self.built)

    @property
    def sweeps(self) -> int:
        return len(self.plan.specs)

    def drawn_for(self, values: Array) -> Array:
        """Of values of all sweeps those of the first, by which the size of an effect is chosen."""
        return values[: self.drawn]

    def each(self, low: float, high: float, law: Callable[..., Array] = Random.uniform) -> Array:
        """A value a sweep; later sweeps leave those of the first as they were."""
        more = self.sweeps - self.drawn
        return np.concatenate([law(self.random, low, high, self.drawn), law(self.later, low, high, more)])

    @property
    def slow(self) -> float:
        """Speed of the slow sweeps, rad/s."""
        return min(abs(spec.offset_velocity) for spec in self.plan.specs[: self.drawn] if spec.offset_velocity)

    @property
    def fastest(self) -> float:
        return float(np.abs(self.wanted.velocity[:, : self.drawn]).max())

    @property
    def starts(self) -> Array:
        return self.drawn_for(self.plan.poses[:, self.index])

    def curve(self, mechanism: Mechanism) -> Curve:
        """Holding torque of a mechanism along every sweep."""
        bare = Rigid(mechanism, self.tilted).curve(self.index, self.plan.poses, REACH)
        values = bare.values.copy()
        for sweeps, loaded in self._loaded(mechanism):
            values[sweeps] = Rigid(loaded, self.tilted).curve(self.index, self.plan.poses[sweeps], REACH).values
        return replace(bare, values=values)

    def rebuild(self, mechanism: Mechanism) -> None:
        """The same axis with other bodies."""
        rigid = Rigid(mechanism, self.tilted)
        poses = self.plan.poses
        self.built = mechanism
        self.train.load = np.array([rigid.inertia(self.index, pose) for pose in poses])
        for sweeps, loaded in self._loaded(mechanism):
            heavier = Rigid(loaded, self.tilted)
            self.train.load[sweeps] = [heavier.inertia(self.index, poses[k]) for k in sweeps]
        self.train.gravity = self.curve(mechanism)

    def weight(self) -> float:
        """Largest holding torque on any sweep, N m."""
        return float(np.abs(self.drawn_for(self.train.gravity.at(self.plan.poses[:, self.index]))).max())

    def toppling(self) -> float:
        """The angle of this axis at which its weight topples, rad: of the nearest A cos q + B sin q."""
        starts = self.plan.poses[:, self.index]
        rows = np.column_stack([np.cos(starts), np.sin(starts)])
        cosine, sine = np.linalg.lstsq(rows, self.train.gravity.at(starts))[0]
        return float(np.arctan2(cosine, -sine))  # where it holds nothing, and less than nothing beyond

    def even(self, value: float) -> Array:
        return np.full(self.sweeps, value)

    def _loaded(self, mechanism: Mechanism) -> Iterator[tuple[list[int], Mechanism]]:
        """The sweeps with each thing that was bolted on, and the mechanism with it."""
        for body in {id(body): body for body in self.carried if body is not None}.values():
            loaded = replace(mechanism, bodies=(*mechanism.bodies[:-1], joined(mechanism.bodies[-1], body)))
            yield [k for k, one in enumerate(self.carried) if one is body], loaded

    def _viscous(self) -> tuple[Array, Array]:
        part = self.random.uniform(0.4, 0.8)
        return self.even(part * self.viscous), self.even((1 - part) * self.viscous)


def steady(level: Array) -> Level:
    """A level that nothing changes."""

    def of(now: Now) -> Array:
        return level

    return of
