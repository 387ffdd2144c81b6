"""Least squares from products of columns, with a prior of the first columns."""

import numpy as np
from numpy.typing import NDArray

from service.model.errors import SweepidError

Array = NDArray[np.float64]

FLAT = 1e-12  # of a column's own product: below, it is a linear combination of the others


class NotFinite(SweepidError):
    """A system has entries that are NaN or infinite; `diagnose_axis` names the axis."""


def symmetric(products: Array) -> Array:
    """The products made symmetric; cross-repeat products are symmetric except for noise."""
    return (products + products.transpose(0, 2, 1)) / 2


def solve(system: Array, precision: Array) -> tuple[Array, float, int]:
    """Least squares from a system (k + 1, k + 1) of [base, columns, right side] and the prior `precision` (b, b) of the
    base: coefficients (k,), cost including that of the prior, rank. NotFinite if the system or the solution is not.
    """
    values, vectors, scale = _scaled(system, precision)
    right, kept = system[:-1, -1] / scale, values > FLAT
    turned = vectors[:, kept].T @ right
    solution = vectors[:, kept] @ (turned / values[kept])
    cost = float(system[-1, -1] - right @ solution)
    _finite(solution, np.array(cost))
    return solution / scale, cost, int(kept.sum())


def covariance(system: Array, precision: Array) -> Array:
    """Covariance (k, k) of the coefficients; undetermined directions get the variance that `FLAT` limits."""
    values, vectors, scale = _scaled(system, precision)
    return (vectors / np.maximum(values, FLAT)) @ vectors.T / np.outer(scale, scale)


def given_rest(system: Array, precision: Array, rest: Array) -> Array:
    """Coefficients (b,) of the base if those of all other columns are fixed at `rest` (k - b,)."""
    b = len(precision)
    _finite(system, precision, rest)
    right = system[:b, -1] - system[:b, b:-1] @ rest
    return np.asarray(np.linalg.solve(system[:b, :b] + precision, right), dtype=np.float64)


def _finite(*parts: Array) -> None:
    """NotFinite unless all are. With a cost of NaN, a search would end as if at a minimum: comparisons are false."""
    if not all(bool(np.isfinite(part).all()) for part in parts):
        raise NotFinite("the equations have entries that are not finite: effort, motion or prior overflow")


def _scaled(system: Array, precision: Array) -> tuple[Array, Array, Array]:
    """Eigenvalues and eigenvectors of the matrix scaled to unit diagonal, and the scale (k,)."""
    _finite(system, precision)
    matrix = system[:-1, :-1].copy()
    matrix[: len(precision), : len(precision)] += precision
    diagonal = np.diag(matrix)
    # a column without effect has a product of zero, or of noise
    # 1e-60 product below which a column counts as zero
    there = diagonal > 1e-60
    scale = np.where(there, np.sqrt(np.where(there, diagonal, 1.0)), 1.0)
    matrix = np.where(np.outer(there, there), matrix, 0.0) / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(matrix)
    return values, vectors, scale
