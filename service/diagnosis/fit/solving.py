"""Least squares from products of columns, with a prior of the first of them."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SMALLEST = 1e-60  # product of a column that is there
FLAT = 1e-12  # of a column's own product: below, it is a combination of the others


def symmetric(products: Array) -> Array:
    """Products without what chance makes of their order."""
    return (products + products.transpose(0, 2, 1)) / 2


def solve(system: Array, precision: Array) -> tuple[Array, float, int]:
    """Least squares from a system (k + 1, k + 1) of [base, columns, right side] and the prior `precision` (b, b) of the
    base: coefficients (k,), cost with the prior's, rank.
    """
    values, vectors, scale = _scaled(system, precision)
    right, kept = system[:-1, -1] / scale, values > FLAT
    turned = vectors[:, kept].T @ right
    solution = vectors[:, kept] @ (turned / values[kept])
    return solution / scale, float(system[-1, -1] - right @ solution), int(kept.sum())


def covariance(system: Array, precision: Array) -> Array:
    """Covariance (k, k) of the same; what is not determined is as uncertain as `FLAT` allows."""
    values, vectors, scale = _scaled(system, precision)
    return (vectors / np.maximum(values, FLAT)) @ vectors.T / np.outer(scale, scale)


def given_rest(system: Array, precision: Array, rest: Array) -> Array:
    """Coefficients (b,) of the base while those of all other columns are `rest` (k - b,)."""
    b = len(precision)
    right = system[:b, -1] - system[:b, b:-1] @ rest
    return np.asarray(np.linalg.solve(system[:b, :b] + precision, right), dtype=np.float64)


def _scaled(system: Array, precision: Array) -> tuple[Array, Array, Array]:
    """Eigenvalues and vectors of the matrix with unit diagonal, and the scale (k,) that made it so."""
    matrix = system[:-1, :-1].copy()
    matrix[: len(precision), : len(precision)] += precision
    diagonal = np.diag(matrix)
    # a column that moves nothing has no product, or noise for one
    there = diagonal > SMALLEST
    scale = np.where(there, np.sqrt(np.where(there, diagonal, 1.0)), 1.0)
    matrix = np.where(np.outer(there, there), matrix, 0.0) / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(matrix)
    return values, vectors, scale
