r"""Inner products of whitened columns between different repeats of the same motion.

The noise of one repeat is in residual and regressors of that repeat at once (a noisy acceleration multiplies the
inertia), so ordinary least squares finds effects that are not there. Products between different repeats have no such
bias: with R repeats of a group, sums over all pairs r != s,

    G = sum X_r' X_s / (R - 1) = ((sum X_r)' (sum X_s) - sum X_r' X_r) / (R - 1)   ->   R X'X

A group that has no repeat enters with its plain products. What repeats leave of each other is the noise; an
autoregressive model of it whitens every column alike, so that one row's variance is 1. A drive may repeat far better
than any model can follow, above all at high frequencies; a share of the gap counts as noise, so that they don't rule.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_toeplitz

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int_]
Gathered = tuple[Array, ...]  # for each fold (k, rows)

ORDER = 8  # of the autoregressive model
MODEL_ERROR = 0.03  # of what the rigid model leaves: white, as no catalogue is exact, however quiet the drive


@dataclass(frozen=True)
class Piece:
    """A stretch of rows of one sweep that another piece repeats."""

    sweep: int
    first: int
    rows: int


@dataclass(frozen=True)
class Group:
    """Pieces of equal length with the same motion; `fold` names what is left out together when effects are tested."""

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
        """The same as weights of rows from the oldest to the newest."""
        return np.append(self.coefficients[::-1], 1.0) / self.sigma


PLAIN = Whitening(np.empty(0), 1.0)


@dataclass(frozen=True)
class Pairing:
    """Where the rows that count lie: for each fold blocks (repeats, rows) of flat indices into (sweeps, rows)."""

    blocks: tuple[tuple[Index, ...], ...]

    @property
    def rows(self) -> int:
        """Rows that count, over all repeats."""
        return sum(block.size for fold in self.blocks for block in fold)

    @property
    def alone(self) -> Array:
        """(folds,): rows that nothing repeats; the noise of each adds 1 to a cost."""
        return np.array([float(sum(block.size for block in fold if len(block) == 1)) for fold in self.blocks])

    def gathered(self, columns: Array) -> Gathered:
        """The rows that count of columns (sweeps, rows, k), fold by fold (k, rows): products of them are `crossed`."""
        n, rows, count = columns.shape
        flat = np.ascontiguousarray(columns.reshape(n * rows, count).T)
        none = np.empty((len(flat), 0))
        return tuple(np.concatenate([none, *(_summed(flat, block) for block in fold)], axis=1) for fold in self.blocks)

    def crossed(self, left: Gathered, right: Gathered) -> Array:
        """(folds, k, l): cross-repeat products of gathered columns."""
        return np.stack([(a * signs) @ b.T for a, b, signs in zip(left, right, self._signs, strict=True)])

    def products(self, columns: Array, others: Array | None = None) -> Array:
        """(folds, k, l): cross-repeat products of columns (sweeps, rows, k), with `others` or with themselves."""
        left = self.gathered(columns)
        return self.crossed(left, left if others is None else self.gathered(others))

    @cached_property
    def _signs(self) -> tuple[Array, ...]:
        """Of each fold's gathered rows: sums of repeats count, their squares go off."""
        return tuple(np.concatenate([np.empty(0), *map(_signed, fold)]) for fold in self.blocks)

    def plain(self, columns: Array) -> Array:
        """(folds, k, k): products of the columns of each repeat with themselves."""
        left = columns.reshape(-1, columns.shape[-1])
        return np.stack(
            [sum((_within(left[b], left[b]) for b in fold), start=_none(left, left)) for fold in self.blocks]
        )


def pairing(usable: Mask, groups: Sequence[Group], order: int, folds: int) -> Pairing:
    """Rows that count in every repeat, with a past of `order` rows that does."""
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
    """The autoregression (Yule and Walker) of what the repeats of residual rows (n, t) leave of their mean.

    `alone` (ORDER + 1,): the noise's autocovariance where nothing was repeated.
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
    """Autocovariance (ORDER + 1,) of the noise that residual rows (n, t) show from one period of so many rows to the
    next; None where fewer than a period's rows have a partner. For sweeps that nothing repeats (Pintelon and Schoukens,
    System Identification, 2012, 2.4: periods of one record are repeats but for what depends on the position).
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
    """Rows (k, all) at a block (repeats, rows): their sum over the repeats, then each repeat, as `_signed` wants it."""
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


def _within(left: Array, right: Array) -> Array:
    return left.reshape(-1, left.shape[-1]).T @ right.reshape(-1, right.shape[-1])


def _none(left: Array, right: Array) -> Array:
    return np.zeros((left.shape[-1], right.shape[-1]))
