"""What the catalogue says of each effect, and what a column may be made of."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.effects.patch import Patch
from service.diagnosis.rows.signals import Tracks

Array = NDArray[np.float64]
Shape = tuple[float, ...]
Readout = Mapping[str, tuple[float, float, str]]
"""Value, standard deviation and unit of parameters by name."""


@dataclass(frozen=True)
class Model:
    """The rigid model as fitted so far: axis inertia of each sweep (n,), reflected motor inertia, viscous friction,
    gravity torque along the motion (n, t), and at the pose (n,) with its slope (n,).
    """

    inertia: Array
    motor_inertia: float
    viscous: float
    gravity: Array
    torque: Array
    slope: Array

    def transmitted(self, acceleration: Array) -> Array:
        """Torque (n, t) through a stiff gear."""
        return self.gravity + self.load_inertia * acceleration

    @property
    def load_inertia(self) -> Array:
        """(n, 1), kg m^2 (kg)."""
        return np.maximum(self.inertia - self.motor_inertia, 0.1 * self.inertia)[:, None]


@dataclass(frozen=True, slots=True)
class ShapeParameter:
    """A parameter in which the columns are not linear: values to scan, limits of the refinement."""

    name: str
    unit: str
    grid: tuple[float, ...]
    low: float
    high: float
    richer: float = 0.0  # part of its value by which physics richer than the columns' shifts it, one sigma


@dataclass(frozen=True)
class Effect:
    """One entry of the catalogue.

    `columns(tracks, model, shape)` are signals (n, t) before the filter, N m (N) for coefficients of one unit;
    `coefficients(tracks)` name them with their units. An effect without columns frees directions of the load
    (`rigid.Rigid.freed`), and `readout(tracks, change, covariance)` makes parameters of the change (3, m) that it makes
    of the load, and its covariance (3 m, 3 m). `entry` is what of a scenario carries the effect, and
    `scenario(parameters, tracks, model)` gives it for coefficients and shape by name; it raises Inexpressible.
    """

    name: str
    physics: str
    source: str
    sentence: str
    visible_in: tuple[str, ...]
    entry: str
    coefficients: Callable[[Tracks], Sequence[tuple[str, str]]] = lambda tracks: ()
    columns: Callable[[Tracks, Model, Shape], Sequence[Array]] = lambda tracks, model, shape: ()
    scenario: Callable[[Mapping[str, float], Tracks, Model], Patch] = lambda parameters, tracks, model: {}
    readout: Callable[[Tracks, Array, Array], Readout] | None = None
    shape: Callable[[Tracks, Model], tuple[ShapeParameter, ...]] = lambda tracks, model: ()
    scan: Callable[[Tracks, Model, Sequence[Shape]], Sequence[Sequence[Array]]] | None = None  # many shapes at once
    essential: int = 0  # number of the column without which it is another, simpler effect
    # whether its parameters are ones that its physics allows: beyond, something else is at work
    possible: Callable[[Mapping[str, float], Tracks, Model], bool] = lambda parameters, tracks, model: True
    rest: float = 0.1  # part of the repeatable excess that its columns may leave: real physics is richer
    by_load: bool = False  # no columns: it frees directions of the load
    # what inertia, torque and slope of the load are multiplied by (3, n, t) behind this effect, to first order
    parts: Callable[[Tracks, Model, Shape], Array] | None = None
    of_model: bool = False  # whether the columns depend on the fitted inertia and friction
    late: bool = False  # whether its first coefficient, s, is a delay of the whole torque, that of other effects too
    by_test_mass: bool = False  # only a known mass tells it from its likes
    contains: tuple[str, ...] = ()  # simpler effects that it can be
    applies: Callable[[Tracks], bool] = lambda tracks: True


def named(*pairs: tuple[str, str]) -> Callable[[Tracks], Sequence[tuple[str, str]]]:
    """Coefficients that are the same for every axis."""
    return lambda tracks: pairs


def spread(low: float, high: float, count: int) -> tuple[float, ...]:
    """`count` values from low to high, at equal ratios."""
    return tuple(np.geomspace(low, high, count).tolist())
