"""A fitted model of one axis: load in each pose, viscous friction, and its effects with their coefficients."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.effects import CATALOGUE
from service.diagnosis.effects.patch import Inexpressible, Patch
from service.diagnosis.fit.equations import Equations, Term, with_base
from service.diagnosis.fit.parameters import by_name, of_load
from service.diagnosis.fit.solving import covariance, solve

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Point:
    """A model: coefficients (b,) of the base; for each term its coefficients and its part of a scenario (None: no
    scenario can contain it); viscous friction, N m s/rad; load (3, m), see `rigid`.
    """

    terms: tuple[Term, ...]
    base: Array
    coefficients: tuple[Array, ...]
    viscous: float
    load: Array
    patches: tuple[Patch | Inexpressible, ...]


def of_columns(given: Equations, terms: Sequence[Term]) -> Point:
    """The fit to all sweeps."""
    values = solve(given.system_with(terms).sum(axis=0), given.precision(terms))[0]
    edges = np.cumsum([given.width_of_base, *(given.width(term) for term in terms)])
    coefficients = tuple(np.split(values, edges)[1:-1])
    there = with_base(given, values[: given.width_of_base])
    patches: list[Patch | Inexpressible] = []
    for term, own in zip(terms, coefficients, strict=True):
        named = by_name(given, term, own)
        named |= {name: one.value for name, one in of_load(given, terms, values, term.effect).items()}
        try:
            patches.append(CATALOGUE[term.effect].scenario(named, given.tracks, there.model))
        except Inexpressible as reason:
            patches.append(reason)
    return Point(
        terms=tuple(terms),
        base=values[: given.width_of_base],
        coefficients=coefficients,
        viscous=there.model.viscous,
        load=given.rigid.load(values[: given.width_of_base - 1]),
        patches=tuple(patches),
    )


def expressible(point: Point) -> list[Patch]:
    """The contributions of the terms to the scenario; Inexpressible if one cannot be written into a scenario."""
    for patch in point.patches:
        if isinstance(patch, Inexpressible):
            raise patch
    return [patch for patch in point.patches if not isinstance(patch, Inexpressible)]


def uncertainty(given: Equations, point: Point) -> tuple[Array, Array]:
    """Covariance (3 m, 3 m) of the load, and (k, k) of the linear coefficients (base and terms)."""
    spread = covariance(given.system_with(point.terms).sum(axis=0), given.precision(point.terms))
    count = given.width_of_base - 1
    basis = given.rigid.basis.reshape(count, -1)
    return basis.T @ spread[:count, :count] @ basis, spread
