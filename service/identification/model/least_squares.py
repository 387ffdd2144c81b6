r"""Weighted least squares that grows measurement by measurement, in information form.

With rows W, values y and covariance C of one batch,

    Lambda += W^T C^-1 W,    eta += W^T C^-1 y,    beta = Lambda^-1 eta,    cov beta = Lambda^-1

so batches may come in any number and order. Columns are scaled by the diagonal of Lambda before anything is inverted.

Where the standard deviations S of a start value are given, columns are scaled by these instead: the eigenvalues of
S Lambda S then say how much better than the start the data tell a direction. One that they tell worse (eigenvalue
below 1) is not followed, wherever noise puts it: it stays at the start, with the start's variance. A parameter that
hangs on such a direction by more than a tenth of its own S is called undetermined.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

Array = NDArray[np.float64]

RANK_TOLERANCE = 1e-12  # of the scaled information matrix's largest eigenvalue
BETTER = 1.0  # times the start's precision: below, data do not tell a direction
HANGS_ON = 0.1  # of its start's standard deviation that a determined parameter may owe to what data do not tell
NOT_TOLD = 1e-8  # of a value's own precision: what is left of it when no other value tells the same


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

    def plus(self, other: "Information") -> "Information":
        """What two independent sets of measurements tell."""
        return Information(self.matrix + other.matrix, self.vector + other.vector, self.count + other.count)

    def solve(self, start: Array, spread: Array | None = None) -> "Solution":
        """Parameters (n,) nearest to `start` where the data leave a choice, with covariance and what is determined.

        `spread` (n,), positive: standard deviations of the start; without, any direction above rounding is followed and
        what stays at the start has no variance.
        """
        scale = 1 / np.sqrt(np.where(np.diag(self.matrix) > 0, np.diag(self.matrix), 1.0)) if spread is None else spread
        eigenvalues, vectors = np.linalg.eigh(self.matrix * np.outer(scale, scale))
        rounding = RANK_TOLERANCE * max(eigenvalues[-1], 1e-300)
        seen = eigenvalues > (rounding if spread is None else max(rounding, BETTER))
        inverse = (vectors[:, seen] / eigenvalues[seen]) @ vectors[:, seen].T
        step = inverse @ ((self.vector - self.matrix @ start) * scale) * scale
        unseen = np.linalg.norm(vectors[:, ~seen], axis=1)
        if spread is None:
            # a parameter is determined when no unseen direction moves it
            return Solution(start + step, inverse * np.outer(scale, scale), unseen < 1e-6)
        covariance = inverse + vectors[:, ~seen] @ vectors[:, ~seen].T
        determined = (unseen < HANGS_ON) & (np.diag(covariance) < 1.0)
        return Solution(start + step, covariance * np.outer(scale, scale), determined)


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


@dataclass(frozen=True)
class LeftOut:
    r"""What the other values say of each value, without solving anew (generalised least squares, n values).

    With M = L^-1 of the covariance C = L L^T, white rows M W = Q R and  P = M^T (1 - Q Q^T) M,  any set f of values is
    off from what all others predict (their correlation with it included) by

        e_f = P_ff^-1 (P y)_f,    cov e_f = P_ff^-1.

    `white` (n, n) is M, `span` (n, k) an orthonormal basis Q, `residual` (n,) white.
    """

    white: Array
    span: Array
    residual: Array

    @classmethod
    def of(cls, rows: Array, values: Array, covariances: Sequence[Array]) -> "LeftOut":
        """Rows (n, p), values (n,), and the blocks of a block-diagonal covariance in the order of the values."""
        white = linalg.block_diag(
            *(
                linalg.solve_triangular(linalg.cholesky(block, lower=True), np.eye(len(block)), lower=True)
                for block in covariances
            )
        )
        white_rows, white_values = white @ rows, white @ values
        length = np.linalg.norm(white_rows, axis=0)
        left, singular, _ = np.linalg.svd(white_rows / np.where(length > 0, length, 1.0), full_matrices=False)
        span = left[:, singular > np.sqrt(RANK_TOLERANCE) * singular.max(initial=0.0)]
        return cls(white, span, white_values - span @ (span.T @ white_values))

    def each(self) -> tuple[Array, Array]:
        """Error and its variance of every value left out alone, (n,) each; infinite variance where no other tells."""
        precision = np.sum(self.white**2, axis=0)
        left = precision - np.sum((self.span.T @ self.white) ** 2, axis=0)
        told = left > NOT_TOLD * precision
        left = np.where(told, left, 1.0)
        return np.where(told, self.white.T @ self.residual / left, 0.0), np.where(told, 1 / left, np.inf)

    def together(self, members: NDArray[np.int_]) -> tuple[Array, Array] | None:
        """Errors (f,) and covariance (f, f) of some values left out at once; None where the others do not tell them."""
        white = self.white[:, members]
        spanned = self.span.T @ white
        precision = white.T @ white
        left = precision - spanned.T @ spanned
        scale = np.sqrt(np.diag(precision))
        if np.linalg.eigvalsh(left / np.outer(scale, scale))[0] < NOT_TOLD:
            return None
        covariance = np.asarray(np.linalg.inv(left / np.outer(scale, scale)), dtype=float) / np.outer(scale, scale)
        return covariance @ (white.T @ self.residual), covariance

    def chi_squared(self, members: NDArray[np.int_]) -> tuple[float, float]:
        """Squared white residual of some values and the degrees of freedom that are left to them."""
        squares = float(np.sum(self.residual[members] ** 2))
        return squares, len(members) - float(np.sum(self.span[members] ** 2))
