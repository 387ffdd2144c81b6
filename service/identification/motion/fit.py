r"""Base parameters from free motions, with a covariance that is consistent with the residuals.

Generalised least squares with the colour of the residuals (below), refined iteratively:

    A = sum_b A_b,  A_b = W_b^T W_b,  beta = A^-1 sum_b W_b^T y_b        (W, y white; b: stretches of 2.0 seconds)

A^-1 would be the covariance if the model were exact. It is not: its error repeats along the path and is not noise. So
the scores s_b = W_b^T (y_b - W_b beta) of the blocks give the spread (sandwich estimate), each corrected for its own
share in the fit so that noise alone gives A (CR2: Bell and McCaffrey 2002): with A = 1 by a change of coordinates,

    C = sum_b (1 - A_b)^-1/2 s_b s_b^T (1 - A_b)^-1/2,      C* = (G C + p c 1) / (G + p),   c = max(1, tr C / p)

G blocks cannot determine p^2 numbers, so C is shrunk towards its mean (Ledoit and Wolf 2004); and it is multiplied by
Student's factor for G - 1 degrees of freedom, so that two standard deviations cover 95 %. Runs of the same
motion have the same model error at the same position: their intervals are one block.

An axis whose residual is an error of the model, and slower than the noise, tells less than its size says. So the
equations of every axis are first divided by the root of its own factor, with A_kb the share of axis k in A_b,

    c_k = max(1, sum_b |s_kb|^2 / sum_b tr(A_kb - A_kb^2)),

the ratio of its scores to those of white noise: what one axis lacks does not weigh on the others.

The blocks' scores cannot show an error that is the same in all of them: it is in the parameters. So what a robot often
has beside the model (`TESTS`) is tried column by column. Where the residual shows it, the change that it would make to
the parameters, beyond noise, is added to the spread, and it is told.

Residuals of a free motion are coloured: an autoregressive model of each axis whitens its equations.

    e_t = r_t - sum_j a_j r_(t-j),   j <= ORDER         (Yule-Walker, Levinson's recursion)

The first samples of an interval have fewer predecessors and use the predictor of lower order with its larger variance,
so an interval of any length is whitened without loss. Intervals end where an axis rests.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from typing import cast

import numpy as np
from scipy.special import ndtr, stdtr, stdtrit

from service import BadInput
from service.identification.model import Information, Rank, finite, scaled_inverse, span
from service.identification.motion.equations import LACKS, AxisEquations
from service.identification.motion.free_motion import FreeMotion, memory
from service.identification.spectra.frequency_response import stretches
from service.model import Array, Indices, Robot

ORDER = 6


@dataclass(frozen=True)
class Colour:
    """Predictors of order 0 to p: `coefficients` (p + 1, p), of the samples 1 to p before; `std` (p + 1,) of errors."""

    coefficients: Array
    std: Array

    @classmethod
    def of(cls, stretches: list[Array], least: float, freedom: float, order: int = ORDER) -> "Colour":
        """From residuals (m_i,) of all intervals; `freedom`: samples minus fitted parameters, `least`: smallest std."""
        order = min(order, max(len(stretch) for stretch in stretches) - 1)
        lags = np.array(
            [sum(float(x[lag:] @ x[: len(x) - lag]) for x in stretches if len(x) > lag) for lag in range(order + 1)]
        )
        lags /= max(freedom, 1.0)
        lags[0] = max(lags[0] * (1 + 1e-9), least**2)
        return cls(*_levinson(lags))

    def whiten(self, signals: Array) -> Array:
        """For one interval (m, ...): prediction errors over their standard deviation."""
        white = np.empty_like(signals)
        for k in range(len(signals)):
            order = min(k, len(self.std) - 1)
            if order == len(self.std) - 1:
                white[k:] = self._full(signals, k)
                break
            predicted = np.tensordot(self.coefficients[order, :order], signals[:k][::-1], axes=1)
            white[k] = (signals[k] - predicted) / self.std[order]
        return white

    def _full(self, signals: Array, order: int) -> Array:
        errors = signals[order:].copy()
        for lag, coefficient in enumerate(self.coefficients[order, :order], start=1):
            errors -= coefficient * signals[order - lag : len(signals) - lag]
        return errors / self.std[order]


def _levinson(lags: Array) -> tuple[Array, Array]:
    """Predictors of all orders and the standard deviations of their errors, from autocovariances (p + 1,)."""
    order = len(lags) - 1
    coefficients, variance = np.zeros((order + 1, order)), np.full(order + 1, lags[0])
    for k in range(1, order + 1):
        before = coefficients[k - 1, : k - 1]
        reflection = (lags[k] - before @ lags[1:k][::-1]) / variance[k - 1]
        coefficients[k, : k - 1] = before - reflection * before[::-1]
        coefficients[k, k - 1] = reflection
        variance[k] = variance[k - 1] * (1 - reflection**2)
    return coefficients, np.sqrt(variance)


LEAST_OUTSIDE = 1e-4  # of the square of a column: least part outside the span of the rows with which it is tested
FOLDS = 5  # every fifth block is held out together


@dataclass(frozen=True)
class FitEvidence:
    """`honest`: information with a covariance consistent with the residuals. `gain_vector` (r, n): contribution of the
    efforts of each axis to `honest.vector`. `scores` (r, r): covariance of A beta - b, of `efforts` (r, n) the sum b of
    the axes. `lacks`: by joint, what the residual shows that the model lacks.
    """

    honest: Information
    gain_vector: Array
    scores: Array
    efforts: Array
    lacks: dict[str, tuple[str, ...]]


@dataclass(frozen=True)
class FreeFit:
    """Fit of all records together to `values` (r,). `moved`: change of them in the last round of fit and colour, in
    standard deviations of least squares (RMS over the parameters).
    """

    joints: tuple[str, ...]  # of the robot
    equations: tuple[AxisEquations, ...]
    white: tuple["WhiteEquations", ...]  # of the same
    values: Array
    moved: float
    folds: tuple[Information, ...]  # of least squares, of every fold of blocks

    @property
    def information(self) -> Information:
        """Of least squares."""
        return reduce(Information.plus, self.folds)

    def without(self, fold: int) -> Information:
        """Information of the other folds."""
        return reduce(Information.plus, (own for number, own in enumerate(self.folds) if number != fold))

    @cached_property
    def evidence(self) -> FitEvidence:
        """Computed in coordinates with information 1; directions that no record shows are left out."""
        to_white, from_white = _coordinates(self.information)
        spread, lacks = _spread(self.white, self.joints, to_white, self.values)
        shrunk = np.asarray(np.linalg.inv(spread), dtype=float)
        own = np.zeros((len(self.values), len(self.joints)))
        for each in self.white:
            own[:, self.joints.index(each.joint)] += each.rows.T @ each.values
        gain_vector = from_white.T @ shrunk @ (to_white.T @ own)
        honest = Information(from_white.T @ shrunk @ from_white, gain_vector.sum(axis=1), self.information.count)
        return FitEvidence(honest, gain_vector, from_white.T @ spread @ from_white, own, lacks)

    def beside(self, others: Information) -> tuple[Information, Array]:
        """Information that gives with `others` (P, p) least squares of both and its own covariance,

            beta = (A + P)^-1 (b + p),    cov beta = (A + P)^-1 (C + P) (A + P)^-1,

        and the contribution (r, n) of the efforts of each axis to its vector. Where C exceeds A, it takes from P.
        """
        whole = self.information.matrix + others.matrix
        share = whole @ scaled_inverse(self.evidence.scores + others.matrix)
        matrix, gains = share @ whole, share @ self.evidence.efforts
        vector = gains.sum(axis=1) + share @ others.vector - others.vector
        return Information((matrix + matrix.T) / 2 - others.matrix, vector, self.information.count), gains


@dataclass(frozen=True)
class WhiteEquations:
    """White rows (m, r) and values (m,) of one axis in one record, with ripple eliminated; block (m,) of each.

    `lacks` (m, t): what the model may lack, in the order of `LACKS`; `springs` (m, n) of all axes.
    """

    joint: str
    rows: Array
    values: Array
    lacks: Array
    springs: Array
    block: Indices

    def over(self, factor: float) -> "WhiteEquations":
        """All divided by a factor."""
        rows, values, lacks, springs = (x / factor for x in (self.rows, self.values, self.lacks, self.springs))
        return WhiteEquations(self.joint, rows, values, lacks, springs, self.block)


def fit_equations(
    robot: Robot,
    records: Sequence[FreeMotion],
    parts: Sequence[AxisEquations],
    prior: Information,
    start: Array,
    order: int = ORDER,
) -> FreeFit:
    """Fit given equations: rows (m, r) of any r parameters, with `record` as their index in `records`.

    `order` of the residuals' colour; 0: only their size is a weight.

    BadInput where no axis moves for long enough, and where an equation or a fitted parameter is not finite.
    """
    rounds = 4  # of fit and colour
    for each in parts:
        finite(
            np.column_stack([each.rows, each.values]),
            f"free motion {records[each.record].ids[0]} of {each.joint}",
            "its equations",
        )
    parts = [each for each in parts if each.sound.any()]
    if not parts:
        ids = ", ".join(record.ids[0] for record in records)
        raise BadInput(f"free motion {ids}", f"no axis moves for more than {2 * memory(records[0].band):.1f} s")
    blocks = _blocks(records, parts)
    size = {joint: _rms(each for each in parts if each.joint == joint) for joint in {each.joint for each in parts}}
    colours = {joint: Colour(np.zeros((1, 0)), np.array([own])) for joint, own in size.items()}
    values, before = start, start
    white: list[WhiteEquations] = []
    for turn in range(rounds):
        white = [_whitened(each, colours[each.joint], block) for each, block in zip(parts, blocks, strict=True)]
        information = _sum(white, len(start))
        before, values = values, information.plus(prior).solve(start).values
        if turn < rounds - 1:
            colours = _colours(parts, values, information, size, order)
    finite(values, f"free motion {records[0].ids[0]}", "the fitted parameters")
    information = _sum(white, len(start))
    change = values - before
    squares, seen = float(change @ information.matrix @ change), int(np.sum(np.diag(information.matrix) > 0))
    white = _levelled(white, information, values)
    folds = tuple(_sum(white, len(start), fold) for fold in range(FOLDS))
    values = reduce(Information.plus, folds).plus(prior).solve(start).values
    moved = float(np.sqrt(max(squares, 0.0) / max(seen, 1)))
    return FreeFit(robot.joints, tuple(parts), tuple(white), values, moved, folds)


def _levelled(white: Sequence[WhiteEquations], information: Information, values: Array) -> list[WhiteEquations]:
    """All equations of an axis divided by the root of its factor c_k."""
    to_white, _ = _coordinates(information)
    squares, expected = ({each.joint: 0.0 for each in white} for _ in range(2))
    for each in white:
        rows, residual = each.rows @ to_white, each.values - each.rows @ values
        for block in np.unique(each.block):
            own = each.block == block
            share = rows[own].T @ rows[own]
            squares[each.joint] += float(np.sum((rows[own].T @ residual[own]) ** 2))
            expected[each.joint] += float(np.trace(share) - np.sum(share**2))
    # an axis has a share of 1e-9 of a parameter at least
    return [each.over(np.sqrt(max(1.0, squares[each.joint] / max(expected[each.joint], 1e-9)))) for each in white]


def _coordinates(information: Information) -> tuple[Array, Array]:
    """(r, p) with beta = start + to_white z, and (p, r) back; z has information 1. Directions without information are
    left out.
    """
    scale = np.sqrt(np.diag(information.matrix))
    scale = np.where(scale > 0, scale, 1.0)
    moments, vectors = np.linalg.eigh(information.matrix / np.outer(scale, scale))
    seen = moments > Rank.rank_tolerance * max(moments[-1], 1e-300)
    to_white = vectors[:, seen] / np.sqrt(moments[seen]) / scale[:, None]
    return to_white, (vectors[:, seen] * np.sqrt(moments[seen])).T * scale


def _rms(parts: Iterable[AxisEquations]) -> float:
    """RMS of the efforts, N m (N)."""
    efforts = np.concatenate([each.values[each.sound] for each in parts])
    return max(float(np.sqrt(np.mean(efforts**2))), 1e-9)  # N m (N)


def _colours(
    parts: Sequence[AxisEquations], values: Array, information: Information, size: dict[str, float], order: int
) -> dict[str, Colour]:
    """By joint, from the residuals of a fit; its parameters are attributed to all equations evenly."""
    freedom = 1 - len(values) / max(information.count, len(values) + 1)
    residuals: dict[str, list[Array]] = {}
    for each in parts:
        left = _without(each.ripple[each.sound], (each.values - each.rows @ values)[each.sound])
        whole = np.zeros(len(each.values))
        whole[each.sound] = left
        residuals.setdefault(each.joint, []).extend(whole[part] for part in stretches(each.sound))
    return {
        # least standard deviation of a residual, of the RMS effort
        joint: Colour.of(own, 1e-5 * size[joint], freedom * sum(map(len, own)), order)
        for joint, own in residuals.items()
    }


def _whitened(each: AxisEquations, colour: Colour, block: Indices) -> WhiteEquations:
    parts = stretches(each.sound)
    together = np.column_stack([each.rows, each.values, each.lacks, each.springs, each.ripple])
    white = np.concatenate([colour.whiten(together[part]) for part in parts]) if parts else together[:0]
    ends = np.cumsum([each.rows.shape[1], 1, each.lacks.shape[1], each.springs.shape[1]])
    left = _without(white[:, ends[-1] :], white[:, : ends[-1]])
    rows, effort, lacks, springs = np.split(left, ends[:-1], axis=1)
    return WhiteEquations(each.joint, rows, effort[:, 0], lacks, springs, block[each.sound])


def _without(columns: Array, signals: Array) -> Array:
    """Signals (m, ...) minus the part explained by columns (m, p)."""
    if not columns.size:
        return signals
    spanned = span(columns)
    return signals - spanned @ (spanned.T @ signals)


def _sum(white: Sequence[WhiteEquations], size: int, fold: int | None = None) -> Information:
    """Of all blocks, or of those of a fold."""
    information = Information.empty(size)
    for each in white:
        kept = slice(None) if fold is None else each.block % FOLDS == fold
        rows, values = each.rows[kept], each.values[kept]
        information = information.plus(Information(rows.T @ rows, rows.T @ values, len(values)))
    return information


def _blocks(records: Sequence[FreeMotion], parts: Sequence[AxisEquations]) -> list[Indices]:
    """Block number of every equation; repeats of a motion share theirs, and so do its periods."""
    first = [next(k for k, other in enumerate(records) if other.same_motion(record)) for record in records]
    periods = [record.period or np.inf for record in records]
    numbers: dict[tuple[int, int], int] = {}
    return [
        np.array([numbers.setdefault((first[k], int(t % periods[k] / 2.0)), len(numbers)) for t in each.time])
        for each in parts
        for k in [each.record]
    ]


def _spread(
    white: Sequence[WhiteEquations], joints: Sequence[str], to_white: Array, values: Array
) -> tuple[Array, dict[str, tuple[str, ...]]]:
    """C* (p, p) with what the model lacks, and that by joint."""
    size = to_white.shape[1]
    blocks, where = np.unique(np.concatenate([each.block for each in white]), return_inverse=True)
    count = len(blocks)
    shares, scores = np.zeros((count, size, size)), np.zeros((count, size))
    rows = np.vstack([each.rows for each in white]) @ to_white
    residual = np.concatenate([each.values - each.rows @ values for each in white])
    for number in range(count):
        own = where == number
        shares[number] = rows[own].T @ rows[own]
        scores[number] = rows[own].T @ residual[own]
    middle = np.zeros((size, size))
    for share, score in zip(shares, scores, strict=True):
        part, directions = np.linalg.eigh(share)
        # limited where a single block determines a direction
        corrected = directions @ ((directions.T @ score) / np.sqrt(1 - np.minimum(part, 0.99)))
        middle += np.outer(corrected, corrected)
    mean = max(1.0, float(np.trace(middle)) / max(size, 1))
    few = float(stdtrit(max(count - 1, 1), ndtr(2.0))) / 2.0
    spread = few**2 * (count * middle + size * mean * np.eye(size)) / (count + size)
    lacking: dict[str, list[str]] = {}
    tests = sum(each.lacks.shape[1] for each in white)
    for joint in dict.fromkeys(each.joint for each in white):
        columns = np.vstack([each.lacks if each.joint == joint else 0 * each.lacks for each in white])
        springs = np.concatenate([each.springs[:, joints.index(joint)] for each in white])
        columns = np.column_stack([columns, springs])
        for name, moved, certain in _lacking(columns, rows, residual, where, count):
            spread += np.outer(moved, moved)
            if certain < 0.01 / tests and name not in lacking.setdefault(joint, []):
                lacking[joint].append(name)
    return spread, {joint: tuple(names) for joint, names in lacking.items()}


def _lacking(
    columns: Array, rows: Array, residual: Array, where: Indices, count: int
) -> Iterator[tuple[str, Array, float]]:
    """Name of each column (m, t) that the residual (m,) shows, the change of the parameters (p,) with it beyond noise,
    and the probability of that by noise: a t-test of the blocks' scores. `rows` (m, p) with `rows.T @ rows` = 1.
    """
    along = rows.T @ columns
    beyond = columns - rows @ along
    power = np.sum(beyond**2, axis=0)
    for k in range(len(power)):
        if power[k] <= LEAST_OUTSIDE * np.sum(columns[:, k] ** 2):
            continue
        scores = np.bincount(where, beyond[:, k] * residual, count)
        total, noise = float(scores.sum()), float(np.var(scores, ddof=1)) * count if count > 1 else 0.0
        if noise <= 0:
            continue
        certain = 2 * cast(float, stdtr(count - 1, -abs(total) / noise**0.5))
        # probability by chance below which it widens the spread
        if certain < 0.01:
            yield (*LACKS, "elasticity of the gear")[k], along[:, k] * (total**2 - noise) ** 0.5 / power[k], certain
