r"""What free motions tell of the base parameters, with a covariance that the residuals keep.

Generalised least squares with the residuals' own colour (`free_motion_noise`), refined in turns:

    A = sum_b A_b,  A_b = W_b^T W_b,  beta = A^-1 sum_b W_b^T y_b        (W, y white; b: stretches of `BLOCK` seconds)

A^-1 would be the covariance were the model exact. It is not: what it lacks repeats along the path and is no noise. So
the scores s_b = W_b^T (y_b - W_b beta) of the blocks tell the spread (sandwich estimate), each corrected for its own
share in the fit so that noise alone gives A (CR2: Bell and McCaffrey 2002): with A = 1 by a change of coordinates,

    C = sum_b (1 - A_b)^-1/2 s_b s_b^T (1 - A_b)^-1/2,      C* = (G C + p c 1) / (G + p),   c = max(1, tr C / p)

G blocks cannot fill p^2 numbers, so C is drawn towards its own mean as Ledoit and Wolf (2004) do; and it grows by
Student's factor for G - 1 degrees of freedom, so that two standard deviations hold what they should. Runs of the same
motion meet the same errors of the model at the same place: their stretches are one block.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm
from scipy.stats import t as student

from service.errors import BadInput
from service.identification.model.base_parameters import BaseParameters
from service.identification.model.least_squares import RANK_TOLERANCE, Information
from service.identification.motion.equations import AxisEquations, equations
from service.identification.motion.free_motion import FreeMotion
from service.identification.motion.noise import Colour, stretches
from service.identification.spectra.low_pass import memory
from service.robot import Robot

Array = NDArray[np.float64]

BLOCK = 2.0  # s
ROUNDS = 4  # of fit and colour
NOISE_LEAST = 1e-5  # of the rated effort: smallest standard deviation of a residual
OWN_SHARE = 0.99  # of a direction that a block may tell alone before its correction ends


@dataclass(frozen=True)
class FreeFit:
    """Of all records together. `information` as least squares has it, for the base parameters (r,), by block and joint.

    `honest`: the same with the covariance that the residuals keep. `gain_vector` (r, n): what the efforts of each axis
    of the robot bring to `honest.vector`.
    """

    equations: tuple[AxisEquations, ...]
    white: tuple["WhiteEquations", ...]  # of the same
    information: Information
    honest: Information
    gain_vector: Array


@dataclass(frozen=True)
class WhiteEquations:
    """White rows (m, r) and values (m,) of one axis in one record, ripple eliminated; block and time (m,) of each."""

    joint: str
    rows: Array
    values: Array
    block: NDArray[np.int_]
    time: Array


def fit_free_motions(
    robot: Robot, base: BaseParameters, records: Sequence[FreeMotion], prior: Information, start: Array
) -> FreeFit:
    """Fit all records at once. `prior` and `start` (r,) keep what no record shows where it was, for the residuals."""
    parts = [each for number, record in enumerate(records) for each in equations(robot, base, record, number)]
    return fit_equations(robot, records, parts, prior, start)


def fit_equations(
    robot: Robot, records: Sequence[FreeMotion], parts: Sequence[AxisEquations], prior: Information, start: Array
) -> FreeFit:
    """Fit equations that are formed already: rows (m, r) of any r parameters, `record` their number in `records`.

    BadInput where no axis moves for long enough.
    """
    parts = [each for each in parts if each.sound.any()]
    if not parts:
        ids = ", ".join(record.ids[0] for record in records)
        raise BadInput(f"free motion {ids}", f"no axis moves for longer than {2 * memory(records[0].band):.1f} s")
    blocks = _blocks(records, parts)
    least = {axis.joint: NOISE_LEAST * axis.rated_effort for axis in robot.axes}
    colours = {each.joint: Colour(np.zeros((1, 0)), np.array([robot.axis(each.joint).rated_effort])) for each in parts}
    values = start
    white: list[WhiteEquations] = []
    for turn in range(ROUNDS):
        white = [_whitened(each, colours[each.joint], block) for each, block in zip(parts, blocks, strict=True)]
        information = _sum(white, len(start))
        values = information.plus(prior).solve(start).values
        if turn < ROUNDS - 1:
            colours = _colours(parts, values, information, least)
    return _honest(robot, parts, white, _sum(white, len(start)), values)


def _colours(
    parts: Sequence[AxisEquations], values: Array, information: Information, least: dict[str, float]
) -> dict[str, Colour]:
    """By joint, from the residuals of a fit; its parameters are charged to all equations alike."""
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
    """Signals (m, ...) less what columns (m, p) explain of them."""
    if not columns.size:
        return signals
    left, singular, _ = np.linalg.svd(columns, full_matrices=False)
    span = left[:, singular > 1e-9 * singular.max(initial=0.0)]
    return signals - span @ (span.T @ signals)


def _sum(white: Sequence[WhiteEquations], size: int) -> Information:
    information = Information.empty(size)
    for each in white:
        own = Information(each.rows.T @ each.rows, each.rows.T @ each.values, len(each.values))
        information = information.plus(own)
    return information


def _blocks(records: Sequence[FreeMotion], parts: Sequence[AxisEquations]) -> list[NDArray[np.int_]]:
    """The number of the block of every equation; repeats of a motion share theirs."""
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
) -> FreeFit:
    """In coordinates in which the information is 1; what no record shows stays out of it."""
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
    return FreeFit(tuple(parts), tuple(white), information, honest, gain_vector)


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
    few = float(student.ppf(norm.cdf(2.0), max(count - 1, 1))) / 2.0
    return few**2 * (count * middle + size * mean * np.eye(size)) / (count + size)
