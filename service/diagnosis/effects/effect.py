"""Definition of an effect in the catalogue, and the rigid model that its columns may use."""

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
    gravity torque along the motion (n, t), and gravity torque at the pose (n,) with its slope (n,).
    """

    inertia: Array
    motor_inertia: float
    viscous: float
    gravity: Array
    torque: Array
    slope: Array

    def transmitted(self, acceleration: Array) -> Array:
        """Torque (n, t) transmitted by a rigid gear."""
        return self.gravity + self.load_inertia * acceleration

    @property
    def load_inertia(self) -> Array:
        """(n, 1), kg m^2 (kg)."""
        return np.maximum(self.inertia - self.motor_inertia, 0.1 * self.inertia)[:, None]


@dataclass(frozen=True, slots=True)
class ShapeParameter:
    """A parameter on which the columns depend nonlinearly: values of the scan, limits of the refinement."""

    name: str
    unit: str
    grid: tuple[float, ...]
    low: float
    high: float
    richer: float = 0.0  # part of its value: one sigma of the bias that simplified columns cause


@dataclass(frozen=True)
class Effect:
    """An effect of the catalogue.

    `columns(tracks, model, shape)` are signals (n, t) before the filter, in N m (N) for coefficients of one unit.
    `coefficients(tracks)` gives their names and units. An effect without columns frees directions of the load
    (`rigid.Rigid.freed`); `readout(tracks, change, covariance)` computes its parameters from the change (3, m) of the
    load and the covariance (3 m, 3 m) of that. `entry` is the part of a scenario that contains the effect, and
    `scenario(parameters, tracks, model)` computes it from coefficients and shape by name; it raises Inexpressible.
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
    scan: Callable[[Tracks, Model, Sequence[Shape]], Sequence[Sequence[Array]]] | None = None  # many shapes in one call
    essential: int = 0  # index of the column without which this is another, simpler effect
    # whether the parameters are physically possible; otherwise the cause is another effect
    possible: Callable[[Mapping[str, float], Tracks, Model], bool] = lambda parameters, tracks, model: True
    rest: float = 0.1  # part of the repeatable excess that its simplified columns may leave
    by_load: bool = False  # no columns: the effect frees directions of the load
    # signals (3, n, t) that multiply inertia, torque and slope of the load with this effect, to first order
    parts: Callable[[Tracks, Model, Shape], Array] | None = None
    of_model: bool = False  # whether the columns depend on the fitted inertia and friction
    late: bool = False  # whether its first coefficient, s, is a delay of the whole torque, including other effects
    by_test_mass: bool = False  # only a test mass separates it from similar effects
    contains: tuple[str, ...] = ()  # simpler effects that are special cases of this one
    applies: Callable[[Tracks], bool] = lambda tracks: True


def named(*pairs: tuple[str, str]) -> Callable[[Tracks], Sequence[tuple[str, str]]]:
    """Names and units of coefficients that are the same for each axis."""
    return lambda tracks: pairs


def spread(low: float, high: float, count: int) -> tuple[float, ...]:
    """`count` values from low to high with a constant ratio."""
    return tuple(np.geomspace(low, high, count).tolist())
