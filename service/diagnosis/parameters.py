"""What a fit says of the parameters of its effects, with standard deviations that do not promise too much.

Shapes are linearised about their best values. Where columns and physics differ, coefficients are less certain than
noise makes them: a share of what is left counts as having moved them too, and if leaving out one pose after the other
moves a coefficient further (the jackknife), that movement is its standard deviation.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.effects import CATALOGUE
from service.diagnosis.equations import Equations, Term, covariance, solve

Array = NDArray[np.float64]

NUDGE = 1e-3  # of a shape parameter, for its derivative
ROUGH = 3e-2  # the same where costs are rough
ABSORBED = 0.01  # part of what is left that may also have moved a parameter


@dataclass(frozen=True, slots=True)
class Parameter:
    """A value with one sigma, and its unit."""

    value: float
    std: float
    unit: str


def parameters(given: Equations, terms: Sequence[Term]) -> list[dict[str, Parameter]]:
    """Coefficients and shapes of each term by name."""
    columns = [given.rows(term) for term in terms]
    system = given.system(np.concatenate(columns, axis=-1))
    values = solve(system.sum(axis=0), given.viscous_precision)[0]
    bends: list[Array] = []
    start = 1
    for term, rows in zip(terms, columns, strict=True):
        own = values[start : start + rows.shape[-1]]
        bends.extend(slopes(given, term, rows @ own, own))
        start += rows.shape[-1]
    extended = np.concatenate([*columns, *(slope[..., None] for slope in bends)], axis=-1)
    full = given.system(extended)
    spread = np.sqrt(np.maximum(np.diag(covariance(full.sum(axis=0), given.viscous_precision)), 0.0))
    scatter = np.zeros_like(spread)
    if len(full) > 2:
        without = [solve(full.sum(axis=0) - own, given.viscous_precision)[0] for own in full]
        scatter = np.std(without, axis=0) * np.sqrt(len(full) - 1)
    left = max(solve(full.sum(axis=0), given.viscous_precision)[1] - float(given.pairs.alone.sum()), 0.0)
    std = np.maximum(spread * np.sqrt(1 + ABSORBED * left), scatter)
    result: list[dict[str, Parameter]] = []
    linear, shape = 1, 1 + sum(rows.shape[-1] for rows in columns)
    for term in terms:
        found: dict[str, Parameter] = {}
        for name, unit in CATALOGUE[term.effect].coefficients(given.tracks):
            found[name] = Parameter(float(values[linear]), float(std[linear]), unit)
            linear += 1
        for entry, value in zip(CATALOGUE[term.effect].shape(given.tracks, given.model), term.shape, strict=True):
            widest = (entry.high - entry.low) / np.sqrt(12)
            sigma = min(np.hypot(std[shape], entry.richer * value), widest)
            found[entry.name] = Parameter(value, float(sigma), entry.unit)
            shape += 1
        result.append(found)
    return result


def slopes(given: Equations, term: Term, at: Array, coefficients: Array) -> list[Array]:
    """Derivative of a term's torque by each of its shape parameters, whitened rows (n, rows)."""
    result: list[Array] = []
    for k, value in enumerate(term.shape):
        step = (NUDGE if CATALOGUE[term.effect].scan is None else ROUGH) * (abs(value) or 1.0)
        moved = Term(term.effect, (*term.shape[:k], value + step, *term.shape[k + 1 :]))
        result.append((given.rows(moved) @ coefficients - at) / step)
    return result
