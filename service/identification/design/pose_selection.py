r"""Selects the poses that identify the base parameters best, one by one; default: D-optimal.

The condition number is the paper's own measure (section 4.3).

With the rows V_i (a, p) of candidate i (one row per axis measured there, columns scaled), each step selects the
best candidate in addition to the selection so far, G = sum V_c' V_c:

    d_optimal               largest  log det(G + ridge + V_i' V_i)
    condition               least  kappa_i = sqrt( lambda_max(G + V_i' V_i) / lambda_min(G + V_i' V_i) )
    condition_and_travel    of all with kappa_i <= SLACK x the least, the one nearest to a pose already chosen

Scaling: by the lengths of the columns over *all* candidates, so nothing depends on units and all steps are judged by
one measure. Start: while no candidate makes G regular, kappa is infinite for all; then the D-optimal one is selected:
it increases rank first and volume second. ridge = 1e-6 of the mean eigenvalue of a single candidate. Ties, to a
relative TIE, go to the first candidate.

Why it is fast and still exact:

Volume. By the matrix determinant lemma the gain is  log det(I + V_i (G + ridge)^-1 V_i'), of (a, a) matrices.

No candidate can make G regular as long as its eigenvalue number a + 1 (ascending) is zero: V_i' V_i has rank a, and by
Weyl's inequality  lambda_1(G + V_i' V_i) <= lambda_{a+1}(G).

Condition. For any orthonormal columns U the eigenvalues of U'(G + V_i' V_i)U lie between those of the whole (Cauchy
interlacing). With U the k lowest eigenvectors of G its least eigenvalue is an upper bound of lambda_min, with U the k
highest its largest is a lower bound of lambda_max: their quotient is a lower bound of kappa_i^2. With k = 1 this costs
two products per row and no eigenvalues. The most promising few are evaluated exactly. A candidate that by its bound for
k = 1 or k = p/4 cannot beat the best of them, or cannot make G regular, is rejected; the rest are evaluated exactly. So
the result is that of evaluating all.

Predicted confidence of the inertia over the workspace for a choice of poses, before the measurement.

Sines of amplitude a_i [rad/s] at omega_i over N samples of effort noise s show, in the imaginary part of the response,

    Im Z_i = omega_i J - k_g / omega_i + omega_i^3 J_l^2 c        each with   var = 2 s^2 / (N a_i^2)

(`drive_train` for small compliance c). If only J is unknown, this is the Cramer-Rao bound  var J = 2 s^2 / (N sum
omega_i^2 a_i^2). Near a known locked-rotor frequency f, all three are multiplied by F_i^2 = (1 - (f_i / f)^2)^-2.
At the lines of axis j axis k shows M_kj in the same way, with omega^3 M_kj (J_lk c_k + J_lj c_j).
The gravity stiffness k_g has its prior, separately for each sweep, and is eliminated; the compliance c is shared by
all sweeps of an axis and stays as an unknown in addition to the base parameters beta, J = w beta. The information of
all sweeps on (beta, c) adds up:  Lambda = [[A, B], [B', C]].  The confidence is the largest standard deviation of J
over the workspace and the axes, in percent of J, conditional on the torque gain.

In directions in which the data are not better than the nominal model the estimate keeps that model, and it states a
confidence only if these hardly matter for J (`least_squares`). `solution` has the rules of the estimate: the same
function, with the information on beta alone,  A - B C^-1 B',  and the spread of the nominal model.

The noise is an assumption before the measurement: white, of a drive that samples at NOISE_RATE and averages
down to the requested rate, so that the noise at a line does not depend on that rate.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import pairwise

import numpy as np

from service.identification.model import Information, Solution
from service.model import Array, Indices, Mask, Sine


@dataclass(frozen=True)
class PoseLimits:
    """When information counts as singular, as equal, as good enough."""

    ridge: float = 1e-6
    singular: float = 1e-12  # of the largest eigenvalue: below it G counts as rank deficient
    tie: float = 1e-8
    slack: float = 1.05  # times the least condition number, allowed by condition_and_travel for a shorter path


class Criterion(Enum):
    """Criterion for the best next pose (see the module docstring)."""

    D_OPTIMAL = "d_optimal"
    CONDITION = "condition"
    CONDITION_AND_TRAVEL = "condition_and_travel"


def choices(
    rows: Array,
    criterion: Criterion,
    poses: Array | None = None,
    start: Sequence[float] | Array = (),
    accept: Callable[[int], bool] = lambda _: True,
    known: Array | None = None,
    seconds: Callable[[Array], Array] | None = None,
    leg: float = 0.0,
) -> Iterator[tuple[int, float]]:
    """All candidates in the order of selection, each with the condition number after it; computed lazily.

    `poses` (m, n) and `start` (n,), the initial pose of the robot: for condition_and_travel, whose path length is
    the sum over the joints, rad (m), because one joint moves at a time. A candidate that `accept` refuses is left
    out. `known` (p, p): information before the first choice, in the units of `rows`. `seconds`: robot time of
    candidates with these path lengths (m,) to the nearest chosen one, `leg` more for each joint that moves; then
    D-optimal is per robot time.
    """
    greedy = _Greedy(rows, known)
    away = np.zeros(len(rows)) if poses is None else path_length(poses, np.asarray(start, dtype=float), leg)
    slack = 1.0
    if criterion is Criterion.CONDITION_AND_TRAVEL:
        if poses is None:
            raise ValueError("condition_and_travel needs the poses")
        slack = PoseLimits.slack
    for _ in range(len(rows)):
        by_volume = criterion is Criterion.D_OPTIMAL
        time = seconds(away) if seconds else np.ones(len(rows))
        pick = greedy.largest_volume(time) if by_volume else greedy.best_conditioned(slack, away)
        greedy.leave_out(pick)
        if accept(pick):
            yield pick, greedy.take(pick)
            if poses is not None:
                away = np.minimum(away, path_length(poses, poses[pick], leg))


def conditions(rows: Array, picks: Sequence[int]) -> list[float]:
    """Condition number after each of `picks` out of the candidates `rows` (m, a, p), as `choices` gives it."""
    greedy = _Greedy(rows)
    return [greedy.take(pick) for pick in picks]


def condition_numbers(eigenvalues: Array) -> Array:
    """Condition numbers (m,) of matrices from the ascending eigenvalues (m, p) of their Gram matrices."""
    largest, smallest = eigenvalues[:, -1], eigenvalues[:, 0]
    regular = smallest > PoseLimits.singular * largest
    return np.sqrt(np.divide(largest, smallest, out=np.full_like(largest, np.inf), where=regular))


def condition_bounds(rows: Array, eigenvalues: Array, vectors: Array, width: int) -> Array:
    """Lower bounds (c,) of the condition number with each of `rows` (c, a, p), see the module docstring.

    From the `width` lowest and highest of the eigenvectors (p, p) of the Gram matrix, whose `eigenvalues` (p,)
    ascend.
    """
    parts = (slice(None, width), slice(-width, None))
    ends = np.hstack([vectors[:, part] for part in parts])
    seen = (rows.reshape(-1, rows.shape[2]) @ ends).reshape(*rows.shape[:2], 2 * width)  # of no rows as well
    lowest, highest = (
        _ritz(np.diag(eigenvalues[part]) + own.swapaxes(1, 2) @ own)
        for part, own in zip(parts, (seen[..., :width], seen[..., width:]), strict=True)
    )
    large, small = highest[:, -1], lowest[:, 0]
    return np.sqrt(large / np.maximum(small, PoseLimits.singular**2 * large + np.finfo(float).tiny))


class _Greedy:
    """The remaining candidates and the Gram matrix of those selected."""

    def __init__(self, rows: Array, known: Array | None = None) -> None:
        length = np.sqrt(np.sum(rows**2, axis=(0, 1)))
        length = np.where(length > 0, length, 1.0)
        self._rows = np.ascontiguousarray(rows / length)
        count, _, size = rows.shape
        self._ridge = PoseLimits.ridge * float(np.sum(self._rows**2)) / count / size
        self._left: Indices = np.arange(count)
        self._gram = np.zeros((size, size)) if known is None else known / np.outer(length, length)

    def leave_out(self, pick: int) -> None:
        """Remove a candidate without selecting it."""
        self._left = self._left[self._left != pick]

    def take(self, pick: int) -> float:
        """Select a candidate. Returns the condition number with it."""
        self._gram = self._gram + self._rows[pick].T @ self._rows[pick]
        return float(condition_numbers(np.asarray(np.linalg.eigvalsh(self._gram)[None], dtype=float))[0])

    def largest_volume(self, time: Array | None = None) -> int:
        """The D-optimal candidate, per `time` (m,)."""
        size = len(self._gram)
        inverse = np.asarray(np.linalg.inv(self._gram + self._ridge * np.eye(size)), dtype=float)
        rows = self._rows[self._left]
        seen = (rows.reshape(-1, size) @ inverse).reshape(rows.shape) @ rows.swapaxes(1, 2)
        gain = np.asarray(np.linalg.slogdet(np.eye(rows.shape[1]) + seen)[1], dtype=float)
        return self._first(self._left, -gain if time is None else -gain / time[self._left], PoseLimits.tie)

    def best_conditioned(self, slack: float, away: Array) -> int:
        """Among the candidates within `slack` of the least condition number the one with the smallest `away` (m,)."""
        eigenvalues, vectors = np.linalg.eigh(self._gram)
        spare = self._rows.shape[1]  # maximum increase of the rank by one candidate
        if spare < len(eigenvalues) and eigenvalues[spare] <= PoseLimits.singular * eigenvalues[-1]:
            return self.largest_volume()
        quick = condition_bounds(self._rows, eigenvalues, vectors, 1)[self._left]
        tried = self._left[np.argsort(quick, kind="stable")[:16]]  # evaluated first
        limit = (1 + PoseLimits.tie) * min(float(self._condition(tried).min()), PoseLimits.singular**-0.5)
        within = self._left[quick <= slack * limit]  # candidates that may be within the slack of the best
        bound = condition_bounds(
            self._rows[within], eigenvalues, vectors, min(len(eigenvalues), max(2, len(eigenvalues) // 4))
        )
        left, within = within[bound <= limit], within[bound <= slack * limit]
        left = np.union1d(left, tried)
        condition = self._condition(left)
        least = float(condition.min())
        if not np.isfinite(least):
            return self.largest_volume()
        if slack > 1:
            left, condition = self._nearest(np.union1d(within, tried), away, slack * (1 + PoseLimits.tie) * least)
        return self._first(left, condition, PoseLimits.tie * least)

    def _nearest(self, candidates: Indices, away: Array, limit: float) -> tuple[Indices, Array]:
        """The candidates with a condition number up to `limit` that have the smallest `away`, with that number."""
        level = np.round(away[candidates] / PoseLimits.tie)
        for nearest in np.unique(level):
            same = candidates[level == nearest]
            condition = self._condition(same)
            if (condition <= limit).any():
                return same[condition <= limit], condition[condition <= limit]
        raise ValueError(f"no candidate has a condition number up to {limit}")

    def _condition(self, candidates: Indices) -> Array:
        """Condition numbers (c,) with each of the candidates (c,)."""
        rows = self._rows[candidates]
        return condition_numbers(np.asarray(np.linalg.eigvalsh(self._gram + rows.swapaxes(1, 2) @ rows), dtype=float))

    @staticmethod
    def _first(candidates: Indices, cost: Array, tie: float) -> int:
        """The candidate of least cost, the first of equal ones."""
        return int(candidates[cost <= cost.min() + tie].min())


def _ritz(matrices: Array) -> Array:
    """Ascending eigenvalues (c, k) of (c, k, k)."""
    return matrices[:, 0] if matrices.shape[1] == 1 else np.asarray(np.linalg.eigvalsh(matrices), dtype=float)


def path_length(poses: Array, pose: Array, leg: float = 0.0) -> Array:
    """Way (...,) of all joints (..., n) one after the other, rad (m), and `leg` for each of them that moves."""
    away = np.abs(poses - pose)
    return away.sum(axis=-1) + leg * np.count_nonzero(away > 1e-9, axis=-1)


@dataclass(frozen=True)
class Assumed:
    """What is assumed of a measurement that is not yet made."""

    effort_noise: float = 0.002  # of the rated effort, of one sample at NOISE_RATE
    noise_rate: float = 1000.0  # Hz
    softest: float = 3.0  # Hz, locked-rotor frequency at one sigma of the compliance, if the spring is unknown


def sweep_information(
    sines: Sequence[Sine],
    duration: float,
    rated_effort: float,
    elastic: Sequence[float],
    stiffness_sigma: float,
    locked_rotor: float | None = None,
) -> Array:
    """Information (1 + c, 1 + c) of one sweep on an inertia and c compliances, 1/(kg m^2)^2 and so on.

    `duration` of its window, s; `elastic` (c,): what the compliances add to the inertia, by omega^2, (kg m^2)^2;
    `stiffness_sigma` of the gravity stiffness' prior, N m/rad; `locked_rotor` frequency, Hz, if it is known.
    """
    frequency = np.array([sine.frequency for sine in sines])
    omega = 2 * np.pi * frequency
    gain = np.ones_like(omega) if locked_rotor is None else (1 - (frequency / locked_rotor) ** 2) ** -2
    noise = Assumed.effort_noise * rated_effort / np.sqrt(Assumed.noise_rate * duration / 2)
    weight = gain * np.array([sine.amplitude for sine in sines]) / noise
    seen = weight[:, None] * np.stack([omega, *(omega**3 * one for one in elastic)], -1)
    stiffness = -weight / omega * stiffness_sigma
    along = stiffness @ seen
    return seen.T @ seen - np.outer(along, along) / (1 + stiffness @ stiffness)


class PredictedConfidence:
    """Confidence updated pose by pose. a axes are measured in each pose; p base parameters."""

    def __init__(
        self,
        rows: Array,
        inertia: Array,
        spread: Array,
        known: Array | None = None,
        pairs: Sequence[tuple[int, int]] = (),
    ) -> None:
        """`rows` (w, a, p) and the model's `inertia` (w, a) of the axes in the poses of the workspace; `spread` (p,):
        standard deviations of the base parameters in the nominal model; `known` (p, p): information that earlier robots
        of the type give. `pairs`: numbers of the axes of the rows of M_kj, which follow those of the axes.
        """
        count, axes, size = rows.shape
        self._axes, self._size, self._spread = axes, size, spread
        self._elastic = [*((axis,) for axis in range(axes)), *pairs]  # axes whose compliances a row depends on
        self._workspace = np.zeros((count * axes, size + axes))
        self._workspace[:, :size] = rows.reshape(-1, size) / inertia.reshape(-1, 1)
        softest = 1 / (np.median(inertia, axis=0) * (2 * np.pi * Assumed.softest) ** 2)
        self._information = np.diag(np.concatenate([np.zeros(size), softest**-2]))
        if known is not None:
            self._information[:size, :size] += known

    def add(self, rows: Array, information: Iterable[Array], sign: float = 1.0) -> None:
        """Add a pose with its rows (a, p), and those of the pairs, and the `sweep_information` of its sweeps."""
        for row, axes, about in zip(rows, self._elastic, information, strict=True):
            parts = np.zeros((1 + len(axes), len(self._information)))
            parts[0, : self._size] = row
            parts[np.arange(1, len(parts)), self._size + np.array(axes)] = 1.0
            self._information += sign * parts.T @ about @ parts

    def remove(self, rows: Array, information: Iterable[Array]) -> None:
        """Undo the `add` of a pose."""
        self.add(rows, information, -1.0)

    def percent(self) -> float:
        """Largest standard deviation of J over the workspace by the sweeps alone, percent of J; inf while rank
        deficient.
        """
        return float(self.percent_by_axis().max())

    def reaches(self, wanted: float) -> bool:
        """Whether the estimate of these sweeps will state a confidence of at most `wanted` percent."""
        return self.percent() <= wanted and self.determines(self.solution())

    def percent_by_axis(self) -> Array:
        """(a,) the same for each axis."""
        unknown = np.full(self._axes, np.inf)
        scale = np.sqrt(np.diag(self._information))
        if not scale.all():
            return unknown
        eigenvalues, vectors = np.linalg.eigh(self._information / np.outer(scale, scale))
        if eigenvalues[0] <= PoseLimits.singular * eigenvalues[-1]:
            return unknown
        parts = (self._workspace / scale) @ (vectors / np.sqrt(eigenvalues))
        return 100 * np.sqrt(np.sum(parts**2, axis=1).reshape(-1, self._axes).max(axis=0))

    def depending(self, parameters: Mask) -> Mask:
        """(a,) axes whose J depends on some of the base `parameters` (p,) in the workspace."""
        rows = self._workspace[:, : self._size] * self._spread  # of a size that can be compared
        size = np.abs(rows).reshape(-1, self._axes, self._size).max(axis=0)
        return (size[:, parameters] > PoseLimits.singular * size.max()).any(axis=1)

    def determines(self, solution: Solution) -> bool:
        """Whether the estimate will state a confidence: the nominal model hardly matters for J over the workspace."""
        return solution.determines(self._workspace[:, : self._size], self._spread)

    def solution(self) -> Solution:
        """What the estimate of these sweeps will determine, if the noise is as assumed, with values of 0."""
        shared = self._information[: self._size, self._size :]
        own = self._information[self._size :, self._size :]
        matrix = self._information[: self._size, : self._size] - shared @ np.linalg.solve(own, shared.T)
        deviation = np.zeros(self._size)  # from the nominal model: the values do not matter, only their precision
        return Information(matrix, deviation).solve(deviation, self._spread)


def needed(predicted: PredictedConfidence, poses: Sequence[tuple[Array, Iterable[Array]]], wanted: float) -> list[int]:
    """Numbers (from 0) of the `poses` without which `predicted`, that of all of them, does not reach `wanted` percent.

    `poses`: rows and information of each, as in `add`. The last ones are tried first; `predicted` is left with the
    rest.
    """
    kept: list[int] = []
    for number in reversed(range(len(poses))):
        predicted.remove(*poses[number])
        if not predicted.reaches(wanted):
            predicted.add(*poses[number])
            kept.insert(0, number)
    return kept


def without_gain(percent: Sequence[float]) -> list[int]:
    """Numbers (from 0) of the poses that add nothing, from the confidence after each.

    Noise averaged over n + 1 instead of n poses falls by 1/(2 n); a pose with less than NO_GAIN of that adds
    nothing.
    """
    return [
        n
        for n, (before, after) in enumerate(pairwise(percent), 1)
        # less than a tenth of the average gain of one more pose adds nothing
        if np.isfinite(before) and 1 - after / before < 0.1 / (2 * n)
    ]
