"""The held-out test: residual before and after each effect, and the model without the effects that fail.

An effect that does not reduce the residual of the held-out sweeps is removed.

The twin (`simulated`): the fitted model is written into a scenario and simulated along the recorded motion.

The columns of the catalogue are simpler than the physics of the simulator. This test shows whether the resulting model
behaves like the columns. Load and viscous friction are fitted again, because the gear of the simulator may distribute
the torque differently between them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.diagnosis.effects import CATALOGUE
from service.diagnosis.effects.effect import Inexpressible, Patch
from service.diagnosis.fit.cross_products import solve
from service.diagnosis.fit.equations import Equations, Term
from service.diagnosis.fit.fitted import Parameter, Point, expressible, of_columns, parameters, uncertainty
from service.diagnosis.fit.gap import by_prior, improves, residual
from service.diagnosis.fit.select import local
from service.diagnosis.model.scenario import axis_entry, gravity_of_fit
from service.diagnosis.model.twin import TwinRun, torques, ways
from service.diagnosis.rows.signals import laid_out
from service.model import Array, Sweep


@dataclass(frozen=True)
class Simulated:
    """Residual of the twin (n, rows), N m, and a description of values that its limits changed."""

    residual: Array
    held: tuple[str, ...]


def simulated(given: Equations, sweeps: Sequence[Sweep], point: Point) -> Simulated:
    """The twin of a model; Inexpressible if no scenario can contain it."""
    tracks = given.tracks
    load: Array = point.load[:, tracks.pose_index]
    inertia, torque, slope = (np.asarray(part, dtype=np.float64) for part in load)
    entry = axis_entry(tracks.robot, tracks.joint, float(np.mean(inertia)), point.viscous, expressible(point))
    pull = gravity_of_fit(tracks.poses[tracks.pose_index], tracks.robot.index(tracks.joint), torque, slope)
    if tracks.prismatic:
        pull = np.stack([torque, np.zeros_like(torque)], axis=-1)
    pulls: list[list[float]] = (pull / entry.scale).tolist()
    runs = [TwinRun(k, entry, float(inertia[k]), (cosine, sine)) for k, (cosine, sine) in enumerate(pulls)]
    own = [sweep for sweep in sweeps if sweep.spec.axis == tracks.joint and sweep.spec.moves]
    needed = torques(tracks.robot, tracks.joint, ways(own), runs)
    left = tracks.rows(tracks.effort - laid_out(tracks, needed))
    system = given.system_of(np.concatenate([given.base, given.whitening(left)[..., None]], axis=-1)).sum(axis=0)
    values = solve(system, given.precision(point.terms))[0]
    return Simulated(left - given.plain_base @ values, entry.held)


@dataclass(frozen=True)
class Fitted:
    """An effect of the model: parameters, covariance (k, k), part of a scenario (None: no scenario can contain it)."""

    effect: str
    parameters: dict[str, Parameter]
    covariance: Array
    patch: Patch | None


@dataclass(frozen=True)
class Fit:
    """The rigid part of the model: load (3, m), see `rigid`, with covariance (3 m, 3 m); viscous friction."""

    load: Array
    covariance: Array
    viscous: float
    viscous_std: float

    @property
    def inertia(self) -> Array:
        return self.load[0]

    @property
    def inertia_std(self) -> Array:
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))[: self.load.shape[1]]


@dataclass(frozen=True)
class HeldOutCheck:
    """The residuals (n, rows), N m (N), before and after, and the model."""

    before: Array
    after: Array
    point: Point
    fitted: tuple[Fitted, ...]
    fit: Fit
    rolled_back: tuple[str, ...]


def check_held_out(given: Equations, fixed: Sequence[Term], added: Sequence[Term]) -> HeldOutCheck:
    """Test the terms `added`, each beside the fixed terms and the others that are left, the last one first."""
    # an effect visible in one pose only: other poses cannot predict its size, so use its repeats
    by_repeat = bool(added) and local(given, fixed, [*fixed, *added])
    terms, rolled_back = [*fixed, *added], list[str]()
    before = residual(given, fixed, by_repeat=by_repeat, as_cad=any(CATALOGUE[term.effect].by_load for term in added))
    after = residual(given, terms, by_repeat=by_repeat) if added else before
    for term in reversed(added):
        fewer = [other for other in terms if other is not term]
        # a gain that comes from the prior alone cannot reduce the residual
        if CATALOGUE[term.effect].by_load or by_prior(given, fewer, terms):
            continue
        without = residual(given, fewer, by_repeat=by_repeat)
        if not improves(given, without, after):
            terms, after = fewer, without
            rolled_back.insert(0, term.effect)
    point = of_columns(given, terms)
    return HeldOutCheck(before, after, point, _fitted(given, point), _fit(given, point), tuple(rolled_back))


def beside_twin(given: Equations, sweeps: Sequence[Sweep], point: Point) -> tuple[float | None, tuple[str, ...]]:
    """The RMS of the twin's residual, N m (N), None if no scenario can contain the model; what is to be said of it."""
    try:
        led = simulated(given, sweeps, point)
    except Inexpressible as reason:
        return None, (f"No scenario can hold this model ({reason}).",)
    rms = float(np.sqrt(np.mean(led.residual[given.tracks.usable] ** 2)))
    return rms, tuple(f"In the twin {held}." for held in led.held)


def _fitted(given: Equations, point: Point) -> tuple[Fitted, ...]:
    fitted = parameters(given, point.terms) if point.terms else []
    result: list[Fitted] = []
    for own, patch, (named, correlation) in zip(point.terms, point.patches, fitted, strict=True):
        std = np.array([parameter.std for parameter in named.values()])
        held = None if isinstance(patch, Inexpressible) else patch
        result.append(Fitted(own.effect, named, correlation * np.outer(std, std), held))
    return tuple(result)


def _fit(given: Equations, point: Point) -> Fit:
    loads, spread = uncertainty(given, point)
    b = given.width_of_base
    return Fit(point.load, loads, point.viscous, float(np.sqrt(spread[b - 1, b - 1])))
