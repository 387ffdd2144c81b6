r"""Base parameters from free motions, with a covariance that is consistent with the residuals.

Generalised least squares with the colour of the residuals (`motion.noise`), refined iteratively:

    A = sum_b A_b,  A_b = W_b^T W_b,  beta = A^-1 sum_b W_b^T y_b        (W, y white; b: stretches of `BLOCK` seconds)

A^-1 would be the covariance if the model were exact. It is not: its error repeats along the path and is not noise. So
the scores s_b = W_b^T (y_b - W_b beta) of the blocks give the spread (sandwich estimate), each corrected for its own
share in the fit so that noise alone gives A (CR2: Bell and McCaffrey 2002): with A = 1 by a change of coordinates,

    C = sum_b (1 - A_b)^-1/2 s_b s_b^T (1 - A_b)^-1/2,      C* = (G C + p c 1) / (G + p),   c = max(1, tr C / p)

G blocks cannot determine p^2 numbers, so C is shrunk towards its mean (Ledoit and Wolf 2004); and it is multiplied by
Student's factor for G - 1 degrees of freedom, so that two standard deviations cover 95 %. Runs of the same
motion have the same model error at the same position: their intervals are one block.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, stdtrit

from service.errors import BadInput
from service.identification.model.base_parameters import BaseParameters
from service.identification.model.convergence import finite
from service.identification.model.least_squares import RANK_TOLERANCE, Information, span
from service.identification.motion.equations import AxisEquations, equations
from service.identification.motion.free_motion import FreeMotion
from service.identification.motion.noise import Colour, stretches
from service.identification.spectra.low_pass import memory
from service.robot import Robot

Array = NDArray[np.float64]

BLOCK = 2.0  # s
ROUNDS = 4  # of fit and colour
NOISE_LEAST = 1e-5  # of the rated effort: smallest standard deviation of a residual
OWN_SHARE = 0.99  # share of a direction determined by a single block at which its correction is limited


@dataclass(frozen=True)
class FreeFit:
    """Fit of all records together. `information`: of least squares, for the base parameters (r,), by block and joint.

    `honest`: with a covariance consistent with the residuals. `gain_vector` (r, n): contribution of the efforts
    of each axis to `honest.vector`. `moved`: change of the values in the last round of
    fit and colour, in standard deviations of `information` (RMS over the observed directions).
    """

    equations: tuple[AxisEquations, ...]
    white: tuple["WhiteEquations", ...]  # of the same
    information: Information
    honest: Information
    gain_vector: Array
    moved: float


@dataclass(frozen=True)
class WhiteEquations:
    """White rows (m, r) and values (m,) of one axis in one record, with ripple eliminated; block and time (m,)
    of each.
    """

    joint: str
    rows: Array
    values: Array
    block: NDArray[np.int_]
    time: Array


def fit_free_motions(
    robot: Robot, base: BaseParameters, records: Sequence[FreeMotion], prior: Information, start: Array
) -> FreeFit:
    """Fit all records together. `prior` and `start` (r,) keep undetermined parameters at their start, for the
    residuals.
    """
    parts = [each for number, record in enumerate(records) for each in equations(robot, base, record, number)]
    return fit_equations(robot, records, parts, prior, start)


def fit_equations(
    robot: Robot, records: Sequence[FreeMotion], parts: Sequence[AxisEquations], prior: Information, start: Array
) -> FreeFit:
    """Fit given equations: rows (m, r) of any r parameters, with `record` as their index in `records`.

    BadInput where no axis moves for long enough, and where an equation or a fitted parameter is not finite.
    """
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
    least = {axis.joint: NOISE_LEAST * axis.rated_effort for axis in robot.axes}
    colours = {each.joint: Colour(np.zeros((1, 0)), np.array([robot.axis(each.joint).rated_effort])) for each in parts}
    values, before = start, start
    white: list[WhiteEquations] = []
    for turn in range(ROUNDS):
        white = [_whitened(each, colours[each.joint], block) for each, block in zip(parts, blocks, strict=True)]
        information = _sum(white, len(start))
        before, values = values, information.plus(prior).solve(start).values
        if turn < ROUNDS - 1:
            colours = _colours(parts, values, information, least)
    finite(values, f"free motion {records[0].ids[0]}", "the fitted parameters")
    return _honest(robot, parts, white, _sum(white, len(start)), values, values - before)


def _colours(
    parts: Sequence[AxisEquations], values: Array, information: Information, least: dict[str, float]
) -> dict[str, Colour]:
    """By joint, from the residuals of a fit; its parameters are attributed to all equations evenly."""
    freedom = 1 - len(values) / max(information.count, len(values) + 1)
    residuals: dict[str, list[Array]] = {}
    for each in parts:
        left = _without(each.ripple[each.sound], (each.values - each.rows @ values)[each.sound])
        whole = np.zeros(len(each.values))
        whole[each.sound] = left
        residuals.setdefault(each.joint, []).extend(whole[part] for part in stretches(each.sound))
    return {joint: Colour.of(own, least[joint], freedom * sum(map(len, own))) for joint, own in residuals.items()}


def _whitened(each: AxisEquations, colour: Colour, block: NDArray[np.int_]) -> WhiteEquations:
    parts = stretches(each.sound)
    together = np.column_stack([each.rows, each.values, each.ripple])
    white = np.concatenate([colour.whiten(together[part]) for part in parts]) if parts else together[:0]
    width = each.rows.shape[1]
    left = _without(white[:, width + 1 :], white[:, : width + 1])
    return WhiteEquations(each.joint, left[:, :width], left[:, width], block[each.sound], each.time[each.sound])


def _without(columns: Array, signals: Array) -> Array:
    """Signals (m, ...) minus the part explained by columns (m, p)."""
    if not columns.size:
        return signals
    spanned = span(columns)
    return signals - spanned @ (spanned.T @ signals)


def _sum(white: Sequence[WhiteEquations], size: int) -> Information:
    information = Information.empty(size)
    for each in white:
        own = Information(each.rows.T @ each.rows, each.rows.T @ each.values, len(each.values))
        information = information.plus(own)
    return information


def _blocks(records: Sequence[FreeMotion], parts: Sequence[AxisEquations]) -> list[NDArray[np.int_]]:
    """Block number of every equation; repeats of a motion share theirs."""
    first = [next(k for k, other in enumerate(records) if other.same_motion(record)) for record in records]
    numbers: dict[tuple[int, int], int] = {}
    return [
        np.array([numbers.setdefault((first[each.record], int(t / BLOCK)), len(numbers)) for t in each.time])
        for each in parts
    ]


def _honest(
    robot: Robot,
    parts: Sequence[AxisEquations],
    white: Sequence[WhiteEquations],
    information: Information,
    values: Array,
    change: Array,
) -> FreeFit:
    """Computed in coordinates with information 1; directions that no record shows are left out.

    `change` (r,): of the values in the last round.
    """
    scale = np.sqrt(np.diag(information.matrix))
    scale = np.where(scale > 0, scale, 1.0)
    moments, vectors = np.linalg.eigh(information.matrix / np.outer(scale, scale))
    seen = moments > RANK_TOLERANCE * max(moments[-1], 1e-300)
    to_white = vectors[:, seen] / np.sqrt(moments[seen]) / scale[:, None]  # beta = start + to_white z
    from_white = (vectors[:, seen] * np.sqrt(moments[seen])).T * scale  # z
    spread = _spread(white, to_white, values)
    shrunk = np.asarray(np.linalg.inv(spread), dtype=float)
    matrix = from_white.T @ shrunk @ from_white
    own = np.zeros((len(values), len(robot.axes)))
    for each in white:
        own[:, robot.index(each.joint)] += each.rows.T @ each.values
    gain_vector = from_white.T @ shrunk @ (to_white.T @ own)
    honest = Information(matrix, gain_vector.sum(axis=1), information.count)
    moved = float(np.sqrt(np.mean((from_white @ change) ** 2))) if seen.any() else 0.0
    return FreeFit(tuple(parts), tuple(white), information, honest, gain_vector, moved)


def _spread(white: Sequence[WhiteEquations], to_white: Array, values: Array) -> Array:
    """C* (p, p)."""
    size = to_white.shape[1]
    count = 1 + max((int(each.block.max(initial=-1)) for each in white), default=-1)
    shares, scores = np.zeros((count, size, size)), np.zeros((count, size))
    for each in white:
        rows = each.rows @ to_white
        residual = each.values - each.rows @ values
        for number in range(count):
            own = each.block == number
            shares[number] += rows[own].T @ rows[own]
            scores[number] += rows[own].T @ residual[own]
    middle = np.zeros((size, size))
    for share, score in zip(shares, scores, strict=True):
        part, directions = np.linalg.eigh(share)
        corrected = directions @ ((directions.T @ score) / np.sqrt(1 - np.minimum(part, OWN_SHARE)))
        middle += np.outer(corrected, corrected)
    mean = max(1.0, float(np.trace(middle)) / max(size, 1))
    few = float(stdtrit(max(count - 1, 1), ndtr(2.0))) / 2.0
    return few**2 * (count * middle + size * mean * np.eye(size)) / (count + size)
