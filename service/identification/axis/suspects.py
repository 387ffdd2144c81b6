r"""Which sweeps do not fit the others, and how much they still count.

Two tests, each against what chance does to the worst of n sound sweeps (`CHANCE`):

- its effort: the residual of its own fit against the pooled noise (`joint_fit`): a torque spike, a collision, a cable;
- its inertia: the value against what all other sweeps of all axes say of that pose,  e_i = J_i - W_i beta_(-i)  over
  its standard deviation: a wrong pose, another payload, a slipped encoder.

A suspect is never dropped. It gets the variance that its misfit shows, v + (e^2 - v), the likeliest value if it has an
error of its own, so its influence falls as 1/e (iteratively reweighted least squares; weight = v / e^2). Where the
whole axis fits badly, the model is to blame and not a sweep: the errors are measured by their own median then.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from service.identification.axis.joint_fit import CHANCE, MATERIAL
from service.identification.model.least_squares import LeftOut

Array = NDArray[np.float64]

ROUNDS = 20
MEDIAN = float(norm.isf(0.25))  # of the size of a standard normal value


@dataclass(frozen=True, slots=True)
class Suspect:
    """A sweep that does not fit; `weight` is what it counts, one being a sound sweep."""

    sweep: str
    axis: str
    why: str
    weight: float


@dataclass(frozen=True)
class Judged:
    """`extra` (n,) variance to add to each inertia, `errors` (n,) from the others' word over its standard deviation."""

    extra: Array
    errors: Array
    left_out: LeftOut


def judge(rows: Array, values: Array, covariances: Sequence[Array]) -> Judged:
    """Inertias of all sweeps (n,), their rows (n, p) in the base parameters and their covariance, a block an axis."""
    edges = accumulate((len(block) for block in covariances), initial=0)
    parts = [slice(a, b) for a, b in pairwise(edges)]
    limit = float(norm.isf(CHANCE / 2 / len(values)))
    extra, errors = np.zeros((2, len(values)))
    left_out = LeftOut.of(rows, values, covariances)
    for _ in range(ROUNDS):
        error, variance = left_out.each()
        chance = variance - extra
        errors = error / np.sqrt(chance)
        scale = np.ones(len(values))
        for part in parts:
            scale[part] = max(1.0, float(np.median(np.abs(errors[part]))) / MEDIAN)
        bad = (np.abs(errors) > limit * scale) & (np.abs(error) > MATERIAL * np.abs(values))
        before, extra = extra, np.where(bad, error**2 - np.where(bad, chance, 0.0), 0.0)
        if np.allclose(extra, before, rtol=1e-2, atol=0.0):
            break
        enlarged = [block + np.diag(extra[part]) for block, part in zip(covariances, parts, strict=True)]
        left_out = LeftOut.of(rows, values, enlarged)
    return Judged(extra, errors, left_out)
