"""Weighted least squares that is extended measurement by measurement, in information form.

With rows W, values y and covariance C of one batch,

    Lambda += W^T C^-1 W,    eta += W^T C^-1 y,    beta = Lambda^-1 eta,    cov beta = Lambda^-1

so batches may be added in any number and order. Columns are scaled by the diagonal of Lambda before any inversion.

If the standard deviations S of a start value are given, columns are scaled by these instead: the eigenvalues of
S Lambda S then are the precision of the data relative to the start in each direction. A direction with less (eigenvalue
below 1) is not changed by noisy data: it stays at the start, with the start's variance. A parameter that
depends on such a direction by more than a tenth of its S counts as undetermined. Values that depend on such directions
by less than a hundredth of what the start leaves open are determined, whatever parameters are not.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy import linalg
from scipy.special import ndtri, stdtrit

from service import BadInput
from service.model import Array, Complex, Indices, Mask


@dataclass(frozen=True)
class Rank:
    """When data determine a direction."""

    rank_tolerance: float = 1e-12  # of the scaled information matrix's largest eigenvalue
    better: float = 1.0  # times the start's precision: below, data do not determine a direction
    at_start: float = 0.01  # of a value's standard deviation at the start: what directions at the start may leave
    unpredicted: float = 1e-8  # of a value's own precision: below, no other value predicts it
    unsettled: float = 0.05  # relative change of a noise estimate in the last round of reweighting: a warning above


@dataclass(frozen=True)
class Information:
    """Information on n parameters: information matrix (n, n), vector (n,), and number of values used."""

    matrix: Array
    vector: Array
    count: int = 0

    @classmethod
    def empty(cls, size: int) -> "Information":
        return cls(np.zeros((size, size)), np.zeros(size))

    def add(self, rows: Array, values: Array, covariance: Array) -> "Information":
        """With a further batch: rows (m, n), values (m,), covariance (m, m) of the values."""
        factor = linalg.cholesky(covariance, lower=True)
        white_rows = linalg.solve_triangular(factor, rows, lower=True)
        white_values = linalg.solve_triangular(factor, values, lower=True)
        return Information(
            self.matrix + white_rows.T @ white_rows,
            self.vector + white_rows.T @ white_values,
            self.count + len(values),
        )

    def plus(self, other: "Information") -> "Information":
        """Combination of two independent sets of measurements."""
        return Information(self.matrix + other.matrix, self.vector + other.vector, self.count + other.count)

    def first(self, size: int, others: "Information") -> tuple["Information", Array]:
        """On the first `size` parameters, whatever the k last ones are, on which there are `others`; and T (k, size):
        its vector is the first part - T^T last part.
        """
        left = self.matrix[:size, size:]
        inner = self.matrix[size:, size:] + others.matrix[size:, size:]
        through = np.asarray(np.linalg.solve(inner, left.T), dtype=float)
        vector = self.vector[:size] - through.T @ self.vector[size:]
        return Information(self.matrix[:size, :size] - left @ through, vector, self.count), through

    def solve(self, start: Array, spread: Array | None = None) -> "Solution":
        """Parameters (n,) closest to `start` where the data do not determine them, with covariance and the determined
        ones.

        `spread` (n,), positive: standard deviations of the start. Without it, every direction above rounding is
        used, and undetermined directions have no variance.
        """
        scale = 1 / np.sqrt(np.where(np.diag(self.matrix) > 0, np.diag(self.matrix), 1.0)) if spread is None else spread
        eigenvalues, vectors = np.linalg.eigh(self.matrix * np.outer(scale, scale))
        rounding = Rank.rank_tolerance * max(eigenvalues[-1], 1e-300)
        seen = eigenvalues > (rounding if spread is None else max(rounding, Rank.better))
        inverse = (vectors[:, seen] / eigenvalues[seen]) @ vectors[:, seen].T
        step = inverse @ ((self.vector - self.matrix @ start) * scale) * scale
        unseen = np.linalg.norm(vectors[:, ~seen], axis=1)
        if spread is None:
            # a parameter is determined if no undetermined direction changes it
            # part of an unseen direction in a parameter, unit vectors
            return Solution(start + step, inverse * np.outer(scale, scale), unseen < 1e-6, np.zeros((len(start), 0)))
        covariance = inverse + vectors[:, ~seen] @ vectors[:, ~seen].T
        # a tenth of its start's standard deviation
        determined = (unseen < 0.1) & (np.diag(covariance) < 1.0)
        return Solution(
            start + step, covariance * np.outer(scale, scale), determined, scale[:, None] * vectors[:, ~seen]
        )


@dataclass(frozen=True)
class Solution:
    """values (n,), covariance (n, n) of the determined ones, determined (n,) bool; `kept` (n, k): directions that stay
    at the start, each one standard deviation of it.
    """

    values: Array
    covariance: Array
    determined: Mask
    kept: Array

    @property
    def std(self) -> Array:
        """(n,) standard deviations; inf for a parameter that the data do not determine."""
        return np.where(self.determined, np.sqrt(np.maximum(np.diag(self.covariance), 0.0)), np.inf)

    def determines(self, rows: Array, spread: Array) -> bool:
        """Whether the start, of these standard deviations (n,), hardly matters for the values of `rows` (m, n)."""
        left, before = (np.linalg.norm(rows @ each, axis=1) for each in (self.kept, np.diag(spread)))
        return bool((left <= Rank.at_start * before).all())


@dataclass(frozen=True)
class LeftOut:
    """Prediction of each value by the others, without a new solution (generalised least squares, n values).

    With M = L^-1 of the covariance C = L L^T, white rows M W = Q R and  P = M^T (1 - Q Q^T) M,  the error of any set
    f of values relative to the prediction by all others (including their correlation with it) is

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
        span = left[:, singular > np.sqrt(Rank.rank_tolerance) * singular.max(initial=0.0)]
        return cls(white, span, white_values - span @ (span.T @ white_values))

    def each(self) -> tuple[Array, Array]:
        """Error and its variance of every value left out alone, (n,) each; infinite variance if no other value predicts
        it.
        """
        precision = np.sum(self.white**2, axis=0)
        left = precision - np.sum((self.span.T @ self.white) ** 2, axis=0)
        predicted = left > Rank.unpredicted * precision
        left = np.where(predicted, left, 1.0)
        return np.where(predicted, self.white.T @ self.residual / left, 0.0), np.where(predicted, 1 / left, np.inf)

    def together(self, members: Indices) -> tuple[Array, Array] | None:
        """Errors (f,) and covariance (f, f) of some values left out together; None if the others do not predict
        them.
        """
        white = self.white[:, members]
        spanned = self.span.T @ white
        precision = white.T @ white
        left = precision - spanned.T @ spanned
        scale = np.sqrt(np.diag(precision))
        if np.linalg.eigvalsh(left / np.outer(scale, scale))[0] < Rank.unpredicted:
            return None
        covariance = np.asarray(np.linalg.inv(left / np.outer(scale, scale)), dtype=float) / np.outer(scale, scale)
        return covariance @ (white.T @ self.residual), covariance

    def chi_squared(self, members: Indices) -> tuple[float, float]:
        """Squared white residual of some values and their remaining degrees of freedom."""
        squares = float(np.sum(self.residual[members] ** 2))
        return squares, len(members) - float(np.sum(self.span[members] ** 2))


def span(columns: Array) -> Array:
    """Orthonormal columns (m, k) that span `columns` (m, p), k <= p."""
    left, singular, _ = np.linalg.svd(columns, full_matrices=False)
    # the directions that columns span
    return left[:, singular > 1e-9 * singular.max(initial=0.0)]


def jackknife_factor(parts: int) -> float:
    """Factor for a jackknife over `parts` parts, so that two standard deviations cover 95 % (Student)."""
    return float(stdtrit(parts - 1, 0.975) / ndtri(0.975))


def _scale(matrix: Array) -> Array:
    """Square roots of the diagonals of matrices (..., p, p): the units differ by ten decades."""
    scale = np.sqrt(np.diagonal(matrix, axis1=-2, axis2=-1))
    return np.where(scale > 0, scale, 1.0)


def scaled_solution(matrix: Array, right: Array) -> Array:
    """Solutions (n, p, m) of positive definite systems (n, p, p), scaled to unit diagonals first."""
    scale = _scale(matrix)[..., None]
    return np.linalg.solve(matrix / scale / np.swapaxes(scale, -1, -2), right / scale) / scale


def scaled_inverse(matrix: Array) -> Array:
    """Inverses of positive definite matrices (..., p, p), scaled to unit diagonals first."""
    scale = _scale(matrix)[..., None]
    eigenvalues, vectors = np.linalg.eigh(matrix / scale / np.swapaxes(scale, -1, -2))
    # about 50 rounding errors
    eigenvalues = np.maximum(eigenvalues, 1e-14 * eigenvalues[..., -1:])
    turned = np.swapaxes(vectors, -1, -2)
    return (vectors / eigenvalues[..., None, :]) @ turned / scale / np.swapaxes(scale, -1, -2)


class SearchResult(Protocol):
    """Result of `scipy.optimize.least_squares`."""

    x: Array
    cost: float
    success: bool
    message: str


def finite(values: Array | Complex, place: str, what: str) -> None:
    """BadInput at `place` where one of `values`, any shape, is NaN or infinite; `what` names them.

    Called before a fit: for such a start SciPy raises an error without axis and sweep, and linear
    solvers return NaN.
    """
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        raise BadInput(
            place, f"{bad.size} of {values.size} values of {what} are not finite, the first is number {bad[0]}"
        )


def unsettled(change: float) -> str | None:
    """The warning if a noise estimate still changes in the last round of reweighting; `change` is relative."""
    if change <= Rank.unsettled:
        return None
    return f"its noise still changes by {100 * change:.0f} % in the last round; limit {100 * Rank.unsettled:.0f} %"


def converged(found: SearchResult, place: str, what: str) -> None:
    """Raises BadInput at `place` unless SciPy's result `found`, the fit of `what`, is a converged and finite
    minimum.
    """
    if not np.isfinite(found.cost):
        raise BadInput(place, f"the fit of {what} has no finite residual")
    if not found.success:
        raise BadInput(place, f"the fit of {what} did not converge: {' '.join(found.message.split())}")
