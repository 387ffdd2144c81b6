"""Inner products of whitened columns between different repeats of the same motion.

Residual and regressors of one repeat contain the same noise (for example, a noisy acceleration multiplies the inertia).
Ordinary least squares therefore finds effects that are not present. Products between different repeats have no such
bias: with R repeats of a group, sums over all pairs r != s,

    G = sum X_r' X_s / (R - 1) = ((sum X_r)' (sum X_s) - sum X_r' X_r) / (R - 1)   ->   R X'X

A group without repeats enters with its plain products. The differences between repeats are the noise; an
autoregressive model of it whitens all columns in the same way, to unit variance of each row. A drive may repeat better
than any model can follow, above all at high frequencies. Therefore a part of the gap counts as noise and limits the
weight of these frequencies.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property

import numpy as np
from scipy.linalg import solve_toeplitz

from service import SweepidError
from service.model import Array, Indices, Mask


class Ended(Enum):
    """How a search ended."""

    SETTLED = "a further step gains too little to matter"
    AT_REST = "no step, also not a shortened or damped one, lowers the cost"
    UNFINISHED = "the result still changes in the last one"


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


Index = Indices
Gathered = tuple[Array, ...]  # for each fold (k, rows)

ORDER = 8  # of the autoregressive model
MODEL_ERROR = 0.03  # of the residual of the rigid model: white noise for model errors, as each effect is simplified


@dataclass(frozen=True)
class Piece:
    """An interval of rows of one sweep that another piece repeats."""

    sweep: int
    first: int
    rows: int


@dataclass(frozen=True)
class Group:
    """Pieces of equal length with the same motion. `fold` is the index of the fold for cross-validation."""

    pieces: tuple[Piece, ...]
    fold: int


@dataclass(frozen=True)
class Whitening:
    """``e_t = (x_t + sum_k a_k x_{t-k}) / sigma``; the identity where `coefficients` is empty."""

    coefficients: Array
    sigma: float

    def __call__(self, rows: Array) -> Array:
        """Rows (n, t) along t; the first rows, which have no past, become 0."""
        result = rows.copy()
        for lag, a in enumerate(self.coefficients.tolist(), 1):
            result[:, lag:] += a * rows[:, :-lag]
        result[:, : len(self.coefficients)] = 0.0
        return result / self.sigma

    @property
    def taps(self) -> Array:
        """The same filter as weights of rows, from the oldest to the newest."""
        return np.append(self.coefficients[::-1], 1.0) / self.sigma


PLAIN = Whitening(np.empty(0), 1.0)


@dataclass(frozen=True)
class Pairing:
    """The usable rows: for each fold, blocks (repeats, rows) of flat indices into (sweeps, rows)."""

    blocks: tuple[tuple[Index, ...], ...]

    @property
    def rows(self) -> int:
        """Number of usable rows in all repeats."""
        return sum(block.size for fold in self.blocks for block in fold)

    @property
    def alone(self) -> Array:
        """(folds,): number of rows without repeats; the noise of each adds 1 to the cost."""
        return np.array([float(sum(block.size for block in fold if len(block) == 1)) for fold in self.blocks])

    def gathered(self, columns: Array) -> Gathered:
        """The usable rows of columns (k, sweeps, rows), by fold (k, rows); `crossed` computes their products."""
        flat = columns.reshape(len(columns), columns.shape[1] * columns.shape[2])
        none = np.empty((len(flat), 0))
        return tuple(np.concatenate([none, *(_summed(flat, block) for block in fold)], axis=1) for fold in self.blocks)

    def crossed(self, left: Gathered, right: Gathered) -> Array:
        """(folds, k, l): cross-repeat products of gathered columns."""
        return np.stack([(a * signs) @ b.T for a, b, signs in zip(left, right, self._signs, strict=True)])

    def products(self, columns: Array, others: Array | None = None) -> Array:
        """(folds, k, l): cross-repeat products of columns (sweeps, rows, k), with `others` or with themselves."""
        left = self.gathered(np.moveaxis(columns, -1, 0))
        return self.crossed(left, left if others is None else self.gathered(np.moveaxis(others, -1, 0)))

    @cached_property
    def _signs(self) -> tuple[Array, ...]:
        """Signs of the gathered rows of each fold: + for sums over repeats, - for the rows of single repeats."""
        return tuple(np.concatenate([np.empty(0), *map(_signed, fold)]) for fold in self.blocks)


def pairing(usable: Mask, groups: Sequence[Group], order: int, folds: int) -> Pairing:
    """Rows that are usable in all repeats, and whose `order` previous rows are usable too."""
    collected: list[dict[int, list[Index]]] = [{} for _ in range(folds)]
    width = usable.shape[1]
    for group in groups:
        good: Mask = np.logical_and.reduce([usable[p.sweep, p.first : p.first + p.rows] for p in group.pieces])
        past = good.copy()
        for lag in range(1, order + 1):
            past[lag:] &= good[:-lag]
            past[:lag] = False
        where = np.flatnonzero(past)
        starts = np.array([p.sweep * width + p.first for p in group.pieces])
        collected[group.fold].setdefault(len(starts), []).append(starts[:, None] + where[None])
    return Pairing(tuple(tuple(np.concatenate(parts, axis=1) for parts in fold.values()) for fold in collected))


def noise_model(residual: Array, usable: Mask, groups: Sequence[Group], alone: Array) -> Whitening:
    """The autoregressive model (Yule-Walker) of residual rows (n, t) minus their mean over the repeats.

    `alone` (ORDER + 1,): autocovariance of the noise, used if nothing was repeated.
    """
    parts: list[Array] = []
    for group in groups:
        count = len(group.pieces)
        if count < 2:
            continue
        rows = np.stack([residual[p.sweep, p.first : p.first + p.rows] for p in group.pieces])
        good = np.stack([usable[p.sweep, p.first : p.first + p.rows] for p in group.pieces]).all(axis=0)
        parts.extend(np.where(good, (rows - rows.mean(axis=0)) * np.sqrt(count / (count - 1)), 0.0))
    counted = sum(int(np.count_nonzero(part)) for part in parts)
    covariance = alone.copy()
    if counted:
        lags = range(ORDER + 1)
        covariance = np.array([sum(float(p[lag:] @ p[: len(p) - lag]) for p in parts) for lag in lags]) / counted
    power = float(np.mean(residual[usable] ** 2))
    covariance[0] = 1.0001 * covariance[0] + max(MODEL_ERROR**2 * max(power - covariance[0], 0.0), 1e-30)
    coefficients = np.asarray(solve_toeplitz(covariance[:-1], -covariance[1:]), dtype=float)
    variance = float(covariance[0] + coefficients @ covariance[1:])
    return Whitening(coefficients, float(np.sqrt(max(variance, 1e-9 * covariance[0]))))


def between_periods(residual: Array, usable: Mask, period: int) -> Array | None:
    """Autocovariance (ORDER + 1,) of the noise from differences of residual rows (n, t) between successive periods of
    `period` rows; None if fewer pairs than one period. For sweeps without repeats (Pintelon and Schoukens, System
    Identification, 2012, 2.4: periods of one record are repeats, except for effects of the position).
    """
    if not 0 < period < residual.shape[1]:
        return None
    good = usable[:, period:] & usable[:, :-period]
    counted = int(np.count_nonzero(good))
    if counted < period:
        return None
    apart = np.where(good, (residual[:, period:] - residual[:, :-period]) / np.sqrt(2), 0.0)
    width = apart.shape[1]
    return np.array([float(np.sum(apart[:, lag:] * apart[:, : width - lag])) for lag in range(ORDER + 1)]) / counted


def _summed(flat: Array, block: Index) -> Array:
    """Rows (k, all) at a block (repeats, rows): sum over the repeats, then each repeat, in the order of `_signs`."""
    rows: Array = flat[:, block]
    count = len(block)
    if count == 1:
        return flat[:, block[0]]
    total: Array = rows.sum(axis=1)
    together: Array = np.concatenate([total, rows.reshape(len(flat), block.size)], axis=1) / np.sqrt(count - 1)
    return together


def _signed(block: Index) -> Array:
    rows, every = int(block.shape[1]), int(block.size)
    signs = np.ones(rows if every == rows else rows + every, dtype=np.float64)
    signs[rows:] = -1.0
    return signs
