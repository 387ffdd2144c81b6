r"""Weighted least squares that grows measurement by measurement, in information form.

With rows W, values y and covariance C of one batch,

    Lambda += W^T C^-1 W,    eta += W^T C^-1 y,    beta = Lambda^-1 eta,    cov beta = Lambda^-1

so batches may come in any number and order. Columns are scaled by the diagonal of Lambda before anything is inverted.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

Array = NDArray[np.float64]

RANK_TOLERANCE = 1e-12  # of the scaled information matrix's largest eigenvalue


@dataclass(frozen=True)
class Information:
    """What is known of n parameters: information matrix (n, n), vector (n,), and how many values went in."""

    matrix: Array
    vector: Array
    count: int = 0

    @classmethod
    def empty(cls, size: int) -> "Information":
        return cls(np.zeros((size, size)), np.zeros(size))

    def add(self, rows: Array, values: Array, covariance: Array) -> "Information":
        """With a batch more: rows (m, n), values (m,), covariance (m, m) of the values."""
        factor = linalg.cholesky(covariance, lower=True)
        white_rows = linalg.solve_triangular(factor, rows, lower=True)
        white_values = linalg.solve_triangular(factor, values, lower=True)
        return Information(
            self.matrix + white_rows.T @ white_rows,
            self.vector + white_rows.T @ white_values,
            self.count + len(values),
        )

    def solve(self, start: Array) -> "Solution":
        """Parameters (n,) nearest to `start` where the data leave a choice, with covariance and what is determined."""
        scale = np.sqrt(np.diag(self.matrix))
        scale = np.where(scale > 0, scale, 1.0)
        eigenvalues, vectors = np.linalg.eigh(self.matrix / np.outer(scale, scale))
        seen = eigenvalues > RANK_TOLERANCE * max(eigenvalues[-1], 1e-300)
        inverse = (vectors[:, seen] / eigenvalues[seen]) @ vectors[:, seen].T
        step = inverse @ ((self.vector - self.matrix @ start) / scale) / scale
        # a parameter is determined when no unseen direction moves it
        determined = np.linalg.norm(vectors[:, ~seen], axis=1) < 1e-6
        return Solution(start + step, inverse / np.outer(scale, scale), determined)


@dataclass(frozen=True)
class Solution:
    """values (n,), covariance (n, n) of what the data determine, determined (n,) bool."""

    values: Array
    covariance: Array
    determined: NDArray[np.bool_]

    @property
    def std(self) -> Array:
        """(n,) standard deviations; inf where the data do not determine the parameter."""
        return np.where(self.determined, np.sqrt(np.maximum(np.diag(self.covariance), 0.0)), np.inf)
