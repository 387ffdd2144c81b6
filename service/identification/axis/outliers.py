r"""Finds sweeps that do not fit the others, and their weight.

Two tests, each with the limit for the worst of n correct sweeps by chance (`CHANCE`):

- its effort: the residual of its own fit relative to the pooled noise (`joint_fit`): a torque spike, a collision, a
  cable;
- its inertia: the value minus the prediction from all other sweeps of all axes,  e_i = J_i - W_i beta_(-i)  over
  its standard deviation: a wrong pose, another payload, a slipped encoder.

A suspect is never dropped. It gets the variance of its misfit, v + (e^2 - v), the most probable value if it has an
separate error, so its influence decreases as 1/e (iteratively reweighted least squares; weight = v / e^2). If the
whole axis fits badly, the cause is the model and not a sweep: then the errors are scaled by their median.

Sweeps that contradict each other can be suspected in turn: with A down-weighted B fits, so A is released, and so on
without end. If the weights have not converged after `FREE_ROUNDS`, a sweep that is suspected once stays suspected and
steps are halved; that ends the cycle with all of them down-weighted, and the result contains a note.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import accumulate, pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from service.identification.axis.joint_fit import CHANCE, MATERIAL
from service.identification.model.least_squares import LeftOut

Array = NDArray[np.float64]

ROUNDS = 40  # of weighting, at most
FREE_ROUNDS = 10  # of them, in which a suspicion may be withdrawn; normal convergence takes about six
WEIGHT_CHANGE = 1e-2  # of each added variance (once held, and of the sweep's own): a smaller change ends the rounds
MEDIAN = -float(ndtri(0.25))  # of the size of a standard normal value


class Ended(Enum):
    """How the weighting ended."""

    SETTLED = "no added variance changes by more than 1 %"
    CONTRADICTION = "sweeps contradict each other: each suspected one stays suspected"
    UNFINISHED = f"the added variances still change after {ROUNDS} rounds"


@dataclass(frozen=True)
class Judged:
    """`extra` (n,) variance to add to each inertia, `errors` (n,) from the prediction by the others, in its standard
    deviations.
    """

    extra: Array
    errors: Array
    left_out: LeftOut
    ended: Ended


def judge(rows: Array, values: Array, covariances: Sequence[Array]) -> Judged:
    """Inertias of all sweeps (n,), their rows (n, p) in the base parameters and their covariance, a block an axis.

    All values must be finite: the caller, which has the sweeps' names, checks that (`estimate`).
    """
    edges = accumulate((len(block) for block in covariances), initial=0)
    parts = [slice(a, b) for a, b in pairwise(edges)]
    limit = -float(ndtri(CHANCE / 2 / len(values)))
    extra, errors = np.zeros((2, len(values)))
    left_out = LeftOut.of(rows, values, covariances)
    own = np.concatenate([np.diag(block) for block in covariances])
    suspected, ended = np.zeros(len(values), dtype=bool), Ended.UNFINISHED
    for number in range(ROUNDS):
        error, variance = left_out.each()
        chance = variance - extra
        errors = error / np.sqrt(chance)
        scale = np.ones(len(values))
        for part in parts:
            scale[part] = max(1.0, float(np.median(np.abs(errors[part]))) / MEDIAN)
        bad = (np.abs(errors) > limit * scale) & (np.abs(error) > MATERIAL * np.abs(values))
        held = number >= FREE_ROUNDS
        suspected = suspected | bad if held else bad
        wanted = np.where(suspected, np.maximum(error**2 - np.where(suspected, chance, 0.0), 0.0), 0.0)
        # two that contradict each other share their difference: full steps would assign it to both and to none in turn
        before, extra = extra, (extra + wanted) / 2 if held else wanted
        if np.all(np.abs(extra - before) <= WEIGHT_CHANGE * (np.abs(before) + (own if held else 0.0))):
            ended = Ended.CONTRADICTION if held else Ended.SETTLED
            break
        enlarged = [block + np.diag(extra[part]) for block, part in zip(covariances, parts, strict=True)]
        left_out = LeftOut.of(rows, values, enlarged)
    return Judged(extra, errors, left_out, ended)
