"""A fitted model of one axis: load in each pose, viscous friction, and its effects with parameters and deviations.

Shapes are linearised at their best values. Because columns are simplified physics, coefficients are less certain than
the noise implies: a part of the residual counts as an additional error. If the jackknife (leaving out one pose after
the other) gives a larger standard deviation, that one is used.

The size c of an effect that frees directions D of the load (z = prior + D c) is the part beyond the prior P,

    c = (D' P D)^-1 D' P z,      cov c = (D' P D)^-1 + G cov z G',   G = (D' P D)^-1 D' P
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.diagnosis.effects import CATALOGUE
from service.diagnosis.effects.effect import Inexpressible, Patch
from service.diagnosis.fit.cross_products import Gathered, covariance, solve
from service.diagnosis.fit.equations import Equations, Term, with_base
from service.model import Array

ABSORBED = 0.01  # part of the residual that counts as an additional parameter error


@dataclass(frozen=True, slots=True)
class Parameter:
    """A value with one sigma, and its unit."""

    value: float
    std: float
    unit: str


def parameters(given: Equations, terms: Sequence[Term]) -> list[tuple[dict[str, Parameter], Array]]:
    """Coefficients and shapes of each term by name, and their correlation (k, k) in the same order."""
    columns, precision = [given.gathered(term) for term in terms], given.precision(terms)
    values = solve(given.system_with(terms).sum(axis=0), precision)[0]
    bends: list[Gathered] = []
    start = given.width_of_base
    for term, rows in zip(terms, columns, strict=True):
        bends.extend(slopes(given, term, values[start : start + len(rows[0])]))
        start += len(rows[0])
    full = given.system_with(terms, *bends)
    whole = full.sum(axis=0)
    spreads = covariance(whole, precision)
    spread = np.sqrt(np.maximum(np.diag(spreads), 0.0))
    scatter = np.zeros_like(spread)
    if len(full) > 2:
        without = [solve(whole - own, precision)[0] for own in full]
        scatter = np.std(without, axis=0) * np.sqrt(len(full) - 1)
    left = max(solve(whole, precision)[1] - float(given.pairs.alone.sum()), 0.0)
    std = np.maximum(spread * np.sqrt(1 + ABSORBED * left), scatter)
    result: list[tuple[dict[str, Parameter], Array]] = []
    linear = given.width_of_base
    shape = linear + sum(len(rows[0]) for rows in columns)
    for term in terms:
        found: dict[str, Parameter] = {}
        first, bent = linear, shape
        for name, unit in CATALOGUE[term.effect].coefficients(given.tracks):
            found[name] = Parameter(float(values[linear]), float(std[linear]), unit)
            linear += 1
        for entry, value in zip(CATALOGUE[term.effect].shape(given.tracks, given.model), term.shape, strict=True):
            widest = (entry.high - entry.low) / np.sqrt(12)
            sigma = min(np.hypot(std[shape], entry.richer * value), widest)
            found[entry.name] = Parameter(value, float(sigma), entry.unit)
            shape += 1
        own = [*range(first, linear), *range(bent, shape)]
        scale = np.maximum(spread[own], 1e-300)
        load = of_load(given, terms, values, term.effect)
        correlation = np.eye(len(found) + len(load))
        correlation[: len(own), : len(own)] = spreads[np.ix_(own, own)] / np.outer(scale, scale)
        result.append((found | load, correlation))
    return result


def of_load(given: Equations, terms: Sequence[Term], values: Array, effect: str) -> dict[str, Parameter]:
    """Parameters of an effect that changes the load, from coefficients (k,) of base and terms; else empty."""
    readout = CATALOGUE[effect].readout
    if readout is None or effect not in given.rigid.freed:
        return {}
    load, directions = values[: given.width_of_base - 1], given.rigid.freed[effect]
    prior = given.rigid.prior([term.effect for term in terms])
    held = directions.T @ prior
    inner = np.linalg.pinv(held @ directions, rcond=1e-12, hermitian=True)
    gain = inner @ held
    count = given.width_of_base - 1
    measured = covariance(given.system_with(terms).sum(axis=0), given.precision(terms))[:count, :count]
    change = directions @ gain @ load
    spread = directions @ (inner + gain @ measured @ gain.T) @ directions.T
    basis = given.rigid.basis.reshape(count, -1)
    found = readout(given.tracks, (change @ basis).reshape(3, -1), basis.T @ spread @ basis)
    return {name: Parameter(*entry) for name, entry in found.items()}


def by_name(given: Equations, term: Term, values: Array) -> dict[str, float]:
    """Coefficients and shape of a term, by name."""
    effect = CATALOGUE[term.effect]
    names = [name for name, _ in effect.coefficients(given.tracks)]
    names += [shape.name for shape in effect.shape(given.tracks, given.model)]
    return dict(zip(names, [*values.tolist(), *term.shape], strict=True))


def slopes(given: Equations, term: Term, coefficients: Array) -> list[Gathered]:
    """Derivative of a term's torque by each of its shape parameters, gathered."""
    result: list[Gathered] = []
    for k, value in enumerate(term.shape):
        # 1e-3 of a shape parameter: step of its numerical derivative
        # 3e-2 the same for costs that are not smooth
        step = (1e-3 if CATALOGUE[term.effect].scan is None else 3e-2) * (abs(value) or 1.0)
        moved = given.gathered(Term(term.effect, (*term.shape[:k], value + step, *term.shape[k + 1 :])), keep=False)
        at = given.gathered(term)
        result.append(tuple(coefficients[None] @ (there - here) / step for there, here in zip(moved, at, strict=True)))
    return result


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
