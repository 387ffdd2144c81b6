"""A fitted model of one axis: inertia of each sweep, viscous friction, and its effects with their coefficients."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.effects import CATALOGUE
from service.diagnosis.effects.effect import Model, Shape
from service.diagnosis.equations import Equations, Term, covariance, nominal_inertia, solve
from service.diagnosis.parameters import slopes
from service.diagnosis.patch import Patch

Array = NDArray[np.float64]

LEAST_INERTIA = 0.05  # of what it was
FARTHEST = 2.0  # times, that a shape may change in one step


@dataclass(frozen=True)
class Point:
    """A model: of each term its coefficients and shape, viscous friction, inertia (n,) of each sweep."""

    terms: tuple[Term, ...]
    coefficients: tuple[Array, ...]
    viscous: float
    inertia: Array


def patches(given: Equations, point: Point) -> list[Patch]:
    """What each term of a model adds to the scenario; Inexpressible."""
    model = at(given, point).model
    result: list[Patch] = []
    for term, values in zip(point.terms, point.coefficients, strict=True):
        result.append(CATALOGUE[term.effect].scenario(by_name(given, term, values), given.tracks, model))
    return result


def derivatives(given: Equations, point: Point) -> Array:
    """Of the torque by coefficients and shapes (n, rows, k), as the columns have them, filtered and whitened."""
    here = at(given, point)
    columns = [here.rows(term) for term in point.terms]
    by_shape = [
        slope[..., None]
        for term, own, values in zip(point.terms, columns, point.coefficients, strict=True)
        for slope in slopes(here, term, own @ values, values)
    ]
    return np.concatenate([given.base[..., :0], *columns, *by_shape], axis=-1)


def uncertainty(given: Equations, every: Array) -> tuple[Array, Array]:
    """Standard deviation (folds,) of inertias; covariance (k, k) of viscous friction, coefficients and shapes.

    `every`: whitened [a, v, derivatives, right side] (n, rows, k + 2).
    """
    products = given.pairs.products(every)
    spread = covariance(given.eliminated(products).sum(axis=0), given.viscous_precision)
    pivot = products[:, 0, 0] + given.inertia_precision
    shared = products[:, 0, 1:-1] / pivot[:, None]
    variance = 1 / pivot + np.einsum("fi,ij,fj->f", shared, spread, shared)
    return np.sqrt(np.maximum(variance, 0.0)), spread


def by_name(given: Equations, term: Term, values: Array) -> dict[str, float]:
    """Coefficients and shape of a term."""
    effect = CATALOGUE[term.effect]
    names = [name for name, _ in effect.coefficients(given.tracks)]
    names += [shape.name for shape in effect.shape(given.tracks, given.model)]
    return dict(zip(names, [*values.tolist(), *term.shape], strict=True))


def at(given: Equations, point: Point) -> Equations:
    """The equations with the inertias and the friction of a model."""
    return replace(given, model=Model(point.inertia, given.model.motor_inertia, point.viscous))


def of_columns(given: Equations, terms: Sequence[Term]) -> Point:
    """What the linear fit says."""
    tracks = given.tracks
    columns = [given.rows(term) for term in terms]
    products = given.pairs.products(np.concatenate([given.base, *columns, given.right[..., None]], axis=-1))
    values = solve(given.eliminated(products).sum(axis=0), given.viscous_precision)[0]
    change = (products[:, 0, -1] - products[:, 0, 1:-1] @ values) / (products[:, 0, 0] + given.inertia_precision)
    nominal = nominal_inertia(tracks.robot, tracks.robot.index(tracks.joint), tracks.poses)[tracks.spot]
    edges = np.cumsum([1, *(rows.shape[-1] for rows in columns)])
    return Point(
        terms=tuple(terms),
        coefficients=tuple(np.split(values, edges)[1:-1]),
        viscous=(tracks.robot.axis(tracks.joint).viscous_friction or 0.0) + float(values[0]),
        inertia=_possible(nominal + change[folds(given)], nominal),
    )


def stepped(given: Equations, point: Point, step: Array, change: Array) -> Point:
    """A model further on by [viscous, coefficients, perhaps shapes] and inertias (n,), within what shapes may be."""
    edges = np.cumsum([1, *map(len, point.coefficients)])
    parts = np.split(step, edges)[1:]
    terms, rest = point.terms, parts.pop()
    if rest.size:
        shapes = iter(rest.tolist())
        terms = tuple(Term(term.effect, _reshaped(given, term, shapes)) for term in point.terms)
    return Point(
        terms=terms,
        coefficients=tuple(old + new for old, new in zip(point.coefficients, parts, strict=True)),
        viscous=point.viscous + float(step[0]),
        inertia=_possible(point.inertia + change, point.inertia),
    )


def _reshaped(given: Equations, term: Term, steps: Iterator[float]) -> Shape:
    limits = CATALOGUE[term.effect].shape(given.tracks, given.model)
    moved: list[float] = []
    for value, limit in zip(term.shape, limits, strict=True):
        low, high = limit.low, limit.high
        if low > 0:
            low, high = max(low, value / FARTHEST), min(high, value * FARTHEST)
        moved.append(float(np.clip(value + next(steps), low, high)))
    return tuple(moved)


def _possible(inertia: Array, reference: Array) -> Array:
    return np.maximum(inertia, LEAST_INERTIA * reference)


def folds(given: Equations) -> NDArray[np.int_]:
    """Of each sweep."""
    result = np.empty(len(given.tracks.specs), dtype=int)
    for group in given.groups:
        result[[piece.sweep for piece in group.pieces]] = group.fold
    return result
