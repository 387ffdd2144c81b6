r"""Chooses, one by one, the poses that tell the base parameters apart best (the paper's section 4.3).

With the rows W_i (a, p) of candidate i (one row an axis measured there), the criterion after a choice C is the
condition number

    kappa(C) = sqrt( lambda_max(G) / lambda_min(G) ),    G = sum_{i in C} V_i' V_i,    V_i = W_i D^-1

Scaling: D holds the lengths of the columns over *all* candidates, so kappa does not depend on units and all steps are
judged by one measure. Start: while G is singular, kappa is infinite for every candidate; then the largest
sum log(lambda + ridge), ridge = 1e-6 of the mean eigenvalue of a single candidate, is taken: it gains rank first and
volume second. Each step evaluates every candidate left by one batched `eigvalsh`. Ties go to the first candidate.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.errors import BadInput

Array = NDArray[np.float64]

RIDGE = 1e-6
SINGULAR = 1e-12  # of the largest eigenvalue: below it G counts as rank deficient


@dataclass(frozen=True)
class Selection:
    """`picks` (k,): candidates in the order of choice; `condition` (k,): number after each, inf while singular."""

    picks: tuple[int, ...]
    condition: tuple[float, ...]


def select_poses(rows: Array, count: int) -> Selection:
    """Greedy choice of `count` out of the candidates `rows` (m, a, p); BadInput if there are fewer than `count`."""
    if len(rows) < count:
        raise BadInput("poses", f"{count} wanted, but only {len(rows)} can be measured")
    length = np.sqrt(np.sum(rows**2, axis=(0, 1)))
    scaled = rows / np.where(length > 0, length, 1.0)
    grams = np.einsum("map,maq->mpq", scaled, scaled)
    ridge = RIDGE * float(np.trace(grams, axis1=1, axis2=2).mean()) / rows.shape[2]

    left = np.arange(len(rows))
    gram = np.zeros(grams.shape[1:])
    picks: list[int] = []
    condition: list[float] = []
    for _ in range(count):
        eigenvalues = np.asarray(np.linalg.eigvalsh(gram + grams[left]), dtype=float)
        kappa = condition_numbers(eigenvalues)
        if np.isfinite(kappa).any():
            best = int(np.argmin(kappa))
        else:
            best = int(np.argmax(np.sum(np.log(np.maximum(eigenvalues, 0.0) + ridge), axis=1)))
        pick = int(left[best])
        picks.append(pick)
        condition.append(float(kappa[best]))
        gram = gram + grams[pick]
        left = np.delete(left, best)
    return Selection(tuple(picks), tuple(condition))


def condition_numbers(eigenvalues: Array) -> Array:
    """Condition numbers (m,) of matrices from the ascending eigenvalues (m, p) of their Gram matrices."""
    largest, smallest = eigenvalues[:, -1], eigenvalues[:, 0]
    regular = smallest > SINGULAR * largest
    return np.sqrt(np.divide(largest, smallest, out=np.full_like(largest, np.inf), where=regular))
