"""Show: what held-out sweeps leave before and after each effect, and the model that is left when nothing is vain.

An effect that leaves no less on sweeps which took no part is rolled back.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.equations import Equations, Term
from service.diagnosis.fitted import Point, by_name, derivatives, of_columns, patches, uncertainty
from service.diagnosis.gap import improves, left_out, noise, residual
from service.diagnosis.parameters import Parameter, parameters
from service.diagnosis.patch import Inexpressible, Patch
from service.diagnosis.proof import Twin
from service.diagnosis.select import local
from service.recording import Sweep

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Fitted:
    """An effect of the model: parameters, their covariance (k, k), what it adds to a scenario (None: nothing can)."""

    effect: str
    parameters: dict[str, Parameter]
    covariance: Array
    patch: Patch | None


@dataclass(frozen=True)
class Fit:
    """The rigid part of the model with its effects: inertia and standard deviation by pose (m,), viscous friction."""

    inertia: Array
    inertia_std: Array
    viscous: float
    viscous_std: float


@dataclass(frozen=True)
class Shown:
    """What is left (n, rows), N m (N), before and after, so many sweeps of it held out; by which `source`, "twin" or
    "columns"; and the model.
    """

    before: Array
    after: Array
    held_out: int
    source: str
    fitted: tuple[Fitted, ...]
    fit: Fit
    rolled_back: tuple[str, ...]
    sentences: tuple[str, ...]


def show(
    given: Equations, sweeps: Sequence[Sweep], fixed: Sequence[Term], added: Sequence[Term], *, twin: bool
) -> Shown:
    """Of the terms `fixed` beforehand and those `added`, in that order."""
    # where one pose alone shows an effect, the others cannot tell how large it is there: its repeats do
    by_repeat = bool(added) and local(given, fixed, [*fixed, *added])
    if twin:
        try:
            return _by_twin(given, sweeps, fixed, added, by_repeat)
        except Inexpressible as reason:
            said = (f"No scenario can hold this model ({reason}): the gap is that of its linear columns.",)
            return _by_columns(given, fixed, added, by_repeat, said)
    return _by_columns(given, fixed, added, by_repeat, ())


def _by_twin(
    given: Equations, sweeps: Sequence[Sweep], fixed: Sequence[Term], added: Sequence[Term], by_repeat: bool
) -> Shown:
    twin = Twin(given, sweeps)
    before = best = twin.simulated(fixed, by_repeat=by_repeat)
    rolled_back: list[str] = []
    for term in added:
        # its start is the linear fit beside the effects kept so far
        further = twin.simulated([*best.point.terms, term], by_repeat=by_repeat)
        if improves(given, best.residual, further.residual):
            best = further
        else:
            rolled_back.append(term.effect)
    said = tuple(f"In the twin {held}." for held in best.held)
    fitted, fit = _model(given, best.point, best.every, doubt(given, best.residual))
    held_out = left_out(given, by_repeat=by_repeat)
    return Shown(before.residual, best.residual, held_out, "twin", fitted, fit, tuple(rolled_back), said)


def _by_columns(
    given: Equations, fixed: Sequence[Term], added: Sequence[Term], by_repeat: bool, said: tuple[str, ...]
) -> Shown:
    terms, rolled_back = [*fixed], list[str]()
    before = after = residual(given, terms, by_repeat=by_repeat)
    for term in added:
        further = residual(given, [*terms, term], by_repeat=by_repeat)
        if improves(given, after, further):
            terms, after = [*terms, term], further
        else:
            rolled_back.append(term.effect)
    point = of_columns(given, terms)
    every = np.concatenate([given.base, derivatives(given, point), given.right[..., None]], axis=-1)
    fitted, fit = _model(given, point, every, 0.0)
    held_out = left_out(given, by_repeat=by_repeat)
    return Shown(before, after, held_out, "columns", fitted, fit, tuple(rolled_back), said)


def doubt(given: Equations, left: Array) -> float:
    """From 0, what is left is noise, to 1, it is all physics that the model does not have."""
    rms = float(np.sqrt(np.mean(left[given.tracks.usable] ** 2)))
    return float(np.sqrt(max(0.0, 1 - (noise(given, left) / rms) ** 2)))


def _model(given: Equations, point: Point, every: Array, doubt: float) -> tuple[tuple[Fitted, ...], Fit]:
    """Parameters as the model has them, correlated as `every` says; as uncertain as the linear fit is.

    While something is left (`doubt`), twin and columns are two opinions: how far they are apart counts as well.
    """
    std, spread = uncertainty(given, every)
    told = parameters(given, point.terms) if point.terms else []
    counts = [len(values) for values in point.coefficients]
    first, shape = 1, 1 + sum(counts)
    result: list[Fitted] = []
    for number, (term, values) in enumerate(zip(point.terms, point.coefficients, strict=True)):
        own = [*range(first, first + counts[number]), *range(shape, shape + len(term.shape))]
        first, shape = first + counts[number], shape + len(term.shape)
        named = {
            name: replace(linear, value=value, std=float(np.hypot(linear.std, doubt * (value - linear.value))))
            for name, value in by_name(given, term, values).items()
            for linear in (told[number][name],)
        }
        result.append(
            Fitted(term.effect, named, _scaled(spread[np.ix_(own, own)], named), _patch(given, point, number))
        )
    spots, where = np.unique(given.tracks.spot, return_index=True)
    fold = {group.pieces[0].sweep: group.fold for group in given.groups}
    of_spot = {int(given.tracks.spot[sweep]): k for sweep, k in fold.items()}
    fit = Fit(point.inertia[where], std[[of_spot[int(k)] for k in spots]], point.viscous, float(np.sqrt(spread[0, 0])))
    return tuple(result), fit


def _scaled(spread: Array, named: dict[str, Parameter]) -> Array:
    """The covariance with the correlations of `spread` and the standard deviations of the parameters."""
    own = np.sqrt(np.maximum(np.diag(spread), 1e-300))
    wanted = np.array([parameter.std for parameter in named.values()])
    return spread * np.outer(wanted / own, wanted / own)


def _patch(given: Equations, point: Point, number: int) -> Patch | None:
    alone = replace(point, terms=(point.terms[number],), coefficients=(point.coefficients[number],))
    try:
        return patches(given, alone)[0]
    except Inexpressible:
        return None
