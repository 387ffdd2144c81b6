"""What the catalogue says of each effect, and what a column may be made of."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.signals import Tracks

Array = NDArray[np.float64]
Shape = tuple[float, ...]


@dataclass(frozen=True)
class Model:
    """The rigid model as fitted so far: axis inertia of each sweep (n,), reflected motor inertia, viscous friction."""

    inertia: Array
    motor_inertia: float
    viscous: float

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


@dataclass(frozen=True)
class Effect:
    """One entry of the catalogue.

    `columns(tracks, model, shape)` are signals (n, t) before the filter, N m (N) for coefficients of one unit;
    `coefficients(tracks)` name them with their units. `entry` is what of a scenario carries the effect.
    """

    name: str
    physics: str
    source: str
    sentence: str
    visible_in: tuple[str, ...]
    entry: str
    coefficients: Callable[[Tracks], Sequence[tuple[str, str]]]
    columns: Callable[[Tracks, Model, Shape], Sequence[Array]]
    shape: Callable[[Tracks, Model], tuple[ShapeParameter, ...]] = lambda tracks, model: ()
    essential: int = 0  # number of the column without which it is another, simpler effect
    plausible: tuple[float, float] = (-np.inf, np.inf)  # of the first coefficient: beyond, something else is at work
    rest: float = 0.1  # part of the repeatable excess that its columns may leave: real physics is richer
    by_test_mass: bool = False  # only a known mass tells it from its likes
    applies: Callable[[Tracks], bool] = lambda tracks: True


def named(*pairs: tuple[str, str]) -> Callable[[Tracks], Sequence[tuple[str, str]]]:
    """Coefficients that are the same for every axis."""
    return lambda tracks: pairs


def spread(low: float, high: float, count: int) -> tuple[float, ...]:
    """`count` values from low to high, at equal ratios."""
    return tuple(np.geomspace(low, high, count).tolist())
