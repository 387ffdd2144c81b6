"""Greedy selection the slow way: the definition of `service.identification.design.pose_selection` written down.

A fresh SVD of the stacked matrix for every candidate of every step. For tests and benchmarks to compare with.
"""

import numpy as np
from numpy.typing import NDArray

from service.identification.design.pose_selection import PoseLimits

Array = NDArray[np.float64]


def naive_condition(rows: Array, count: int) -> tuple[list[int], list[float]]:
    """Picks and condition numbers of the criterion `condition` out of candidates (m, a, p)."""
    candidates, _, size = rows.shape
    length = np.sqrt(np.sum(rows**2, axis=(0, 1)))
    scaled = rows / np.where(length > 0, length, 1.0)
    ridge = PoseLimits.ridge * float(np.sum(scaled**2)) / candidates / size
    picks: list[int] = []
    numbers: list[float] = []
    stacked = np.zeros((0, size))
    for _ in range(count):
        condition = np.full(candidates, np.inf)
        volume = np.full(candidates, -np.inf)
        for k in range(candidates):
            if k not in picks:
                singular = np.zeros(size)
                found = np.linalg.svd(np.vstack([stacked, scaled[k]]), compute_uv=False)
                singular[: len(found)] = found
                volume[k] = np.log(singular**2 + ridge).sum()
                if singular[-1] > np.sqrt(PoseLimits.singular) * singular[0]:
                    condition[k] = singular[0] / singular[-1]
        least = float(condition.min())
        if np.isfinite(least):
            pick = int(np.flatnonzero(condition <= least * (1 + PoseLimits.tie))[0])
        else:
            pick = int(np.flatnonzero(volume >= volume.max() - PoseLimits.tie)[0])
        picks.append(pick)
        numbers.append(float(condition[pick]))
        stacked = np.vstack([stacked, scaled[pick]])
    return picks, numbers
