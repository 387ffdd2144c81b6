"""Definition of an effect, the rigid model that its columns may use, its part of a scenario, and the catalogue.

A part of a scenario (`Patch`) has the format of docs/reference/scenario.md. "train" and "measurement" belong to the
axis, "links" to the robot. To merge patches, numbers are added and lists are concatenated. All torques are as
recorded; `scenario.axis_entry` corrects the rest for a wrong torque constant.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import EntryPoint, entry_points
from typing import Any, NotRequired, TypedDict, TypeVar, cast

import numpy as np

from service import BadInput
from service.diagnosis.rows.signals import Tracks
from service.model import Array

Parts = dict[str, float]  # of a spring, of a ripple, ...


class FrictionEntry(TypedDict, total=False):
    """Levels, N m, and viscous friction, N m s/rad; in both directions alike unless there is a backward value."""

    viscous: float
    backward_viscous: float
    coulomb: float
    backward_coulomb: float


class TrainEntry(TypedDict):
    """Drive train of an axis."""

    motor_inertia: float
    motor_friction: FrictionEntry
    effort_gain: float
    effort_offset: float
    load_friction: NotRequired[FrictionEntry]
    spring: NotRequired[Parts]
    cogging: NotRequired[list[Parts]]
    counterbalance: NotRequired[list[Parts]]


class Bar(TypedDict):
    """A solid cylinder between two points of its link, kg and m."""

    mass: float
    radius: float
    start: Sequence[float]
    end: Sequence[float]


class LinkEntry(TypedDict, total=False):
    """Differences of a link from CAD: factor of its mass, shift of its centre, factor of its inertia, added bodies."""

    mass: float
    shift: list[float]
    inertia: float
    added: list[Bar]


class Patch(TypedDict, total=False):
    """Part of a scenario, by what it belongs to."""

    train: Mapping[str, object]
    measurement: Parts
    links: dict[str, LinkEntry]


AnyPart = TypeVar("AnyPart", bound=Mapping[str, object])


class Inexpressible(Exception):
    """A parameter has a value that no scenario can contain; the text names it."""


def positive(parameters: Mapping[str, float], name: str) -> float:
    """The value of a parameter; Inexpressible if it is not above 0."""
    if parameters[name] <= 0:
        raise Inexpressible(f"{name} = {parameters[name]:.3g} is not above 0")
    return parameters[name]


def dry(forward: float, backward: float | None = None, **more: object) -> Patch:
    """Dry friction of the motor, N m; the same in both directions unless `backward` is given."""
    other = forward if backward is None else backward
    return {"train": {"motor_friction": {"coulomb": forward, "backward_coulomb": other} | more}}


def ripples(parameters: Mapping[str, float], orders: Sequence[float]) -> list[Parts]:
    """``A sin(o theta) + B cos(o theta)`` of each order as amplitude and phase."""
    pairs = [(order, parameters[f"sine_{order:g}"], parameters[f"cosine_{order:g}"]) for order in orders]
    return [
        {"order": order, "amplitude": float(np.hypot(sine, cosine)), "phase": float(np.arctan2(cosine, sine))}
        for order, sine, cosine in pairs
    ]


def merged(first: AnyPart, second: Mapping[str, object]) -> AnyPart:
    """Both parts of a scenario: numbers added, lists concatenated, all other values from the second."""
    result: Any = dict(first)
    for key, value in second.items():
        old = result.get(key)
        if isinstance(value, Mapping):
            result[key] = merged(cast("Mapping[str, object]", old or {}), cast("Mapping[str, object]", value))
        elif isinstance(value, list):
            result[key] = [*(old or []), *value]
        else:
            result[key] = value if old is None else old + value
    return result


Shape = tuple[float, ...]
Readout = Mapping[str, tuple[float, float, str]]
"""Value, standard deviation and unit of parameters by name."""


@dataclass(frozen=True)
class Model:
    """The rigid model as fitted so far: axis inertia of each sweep (n,), reflected motor inertia, viscous friction,
    gravity torque along the motion (n, t) with that of the counterbalance, and gravity torque at the pose (n,) with its
    slope (n,). `beside`: torque of effects (n, t) that is in the effort, but not transmitted by the gear.
    """

    inertia: Array
    motor_inertia: float
    viscous: float
    gravity: Array
    torque: Array
    slope: Array
    beside: Array

    @cached_property
    def key(self) -> int:
        """Of `beside`."""
        return hash(self.beside.tobytes())

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
class CatalogueEffect:
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
    on_load: tuple[bool, ...] = (False,)  # whether its torque acts on the load, behind the gear; of columns in turn
    of_model: bool = False  # whether the columns depend on the fitted inertia and friction
    late: bool = False  # whether its first coefficient, s, is a delay of the whole torque, including other effects
    of_time: bool = False  # whether the columns depend on the time, and so differ between repeats
    exact: bool = False  # its size is known: an effect that frees more of the load must explain more
    by_test_mass: bool = False  # only a test mass separates it from similar effects
    # shape with which its columns are what a weight pulls: where these explain as much, gravity may be the cause
    as_weight: Shape | None = None
    contains: tuple[str, ...] = ()  # simpler effects that are special cases of this one
    applies: Callable[[Tracks], bool] = lambda tracks: True


def named(*pairs: tuple[str, str]) -> Callable[[Tracks], Sequence[tuple[str, str]]]:
    """Names and units of coefficients that are the same for each axis."""
    return lambda tracks: pairs


def spread(low: float, high: float, count: int) -> tuple[float, ...]:
    """`count` values from low to high with a constant ratio."""
    return tuple(np.geomspace(low, high, count).tolist())


GROUP = "sweepid.effects"


class Catalogue(Mapping[str, CatalogueEffect]):
    """Effects by name: those of sweepid in their order, then the others in alphabetical order.

    Entry points are loaded at the first access, not at import, because the packages import this module. If one
    cannot be used, each access raises BadInput with the names of the package and the entry point.
    """

    def __init__(self, shipped: Iterable[CatalogueEffect]) -> None:
        self._shipped = {effect.name: effect for effect in shipped}

    def __getitem__(self, name: str) -> CatalogueEffect:
        return self._all[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._all)

    def __len__(self) -> int:
        return len(self._all)

    @property
    def brought(self) -> dict[str, str]:
        """The effects of other packages, with the name of the package of each."""
        return {entry.name: _package(entry) for entry in _entries() if entry.name in self._all}

    @cached_property
    def _all(self) -> dict[str, CatalogueEffect]:
        effects, owners = dict(self._shipped), dict.fromkeys(self._shipped, "sweepid")
        for entry in _entries():
            if entry.name in owners:
                raise BadInput(_place(entry), f"an effect of this name comes with {owners[entry.name]} already")
            effects[entry.name], owners[entry.name] = _loaded(entry), _package(entry)
        return effects


def _entries() -> list[EntryPoint]:
    return sorted(entry_points(group=GROUP), key=lambda entry: (entry.name, _package(entry)))


def _loaded(entry: EntryPoint) -> CatalogueEffect:
    try:
        effect = entry.load()
    except Exception as error:  # a foreign module may raise any exception during its import
        raise BadInput(_place(entry), f"cannot be loaded: {type(error).__name__}: {error}") from error
    if not isinstance(effect, CatalogueEffect):
        raise BadInput(
            _place(entry), f"is {type(effect).__name__}, not service.diagnosis.effects.effect.CatalogueEffect"
        )
    if effect.name != entry.name:
        raise BadInput(_place(entry), f"its effect calls itself {effect.name!r}: both must have the same name")
    return effect


def _place(entry: EntryPoint) -> str:
    return f"package {_package(entry)}, entry point {GROUP}: {entry.name} = {entry.value}"


def _package(entry: EntryPoint) -> str:
    return "without a name" if entry.dist is None else f"{entry.dist.name} {entry.dist.version}"
