"""Weights of sweeps that do not fit: they settle, or it is said that they do not."""

import numpy as np
import pytest

from service.identification.estimates.estimate import Judged, WeightingEnded, judge
from service.identification.model.least_squares import Array

STD, PARAMETERS = 0.1, np.array([10.0, 1.0, 2.0, 3.0])


def campaign(seed: int, spoiled: int, size: float) -> tuple[Array, Array]:
    """Rows (n, 4) and inertias (n,) of 5 to 19 poses, one to three sweeps each; `spoiled` of them off by `size`."""
    rng = np.random.default_rng(seed)
    poses, repeats = rng.integers(5, 20), rng.integers(1, 4)
    rows = np.repeat(rng.standard_normal((poses, 4)), repeats, axis=0)
    rows[:, 0] += 5
    values = rows @ PARAMETERS + STD * rng.standard_normal(len(rows))
    bad = rng.choice(len(rows), min(spoiled, len(rows)), replace=False)
    values[bad] += size * rng.choice([-1, 1], len(bad))
    return rows, values


def judged(seed: int, spoiled: int, size: float, rounds: int = 40) -> Judged:
    rows, values = campaign(seed, spoiled, size)
    return judge(rows, values, [STD**2 * np.eye(len(values))], rounds)


def test_one_bad_sweep_settles_at_once() -> None:
    ended = [judged(seed, 1, 3.0).ended for seed in range(100)]
    assert ended.count(WeightingEnded.SETTLED) >= 97


@pytest.mark.parametrize(("seed", "spoiled", "size"), [(29, 5, 3.0), (43, 5, 3.0), (27, 2, 10.0)])
def test_sweeps_that_contradict_each_other_are_all_suspected(seed: int, spoiled: int, size: float) -> None:
    """They used to be suspected in turns, and an even and an odd number of rounds named different ones."""
    found = judged(seed, spoiled, size)
    assert found.ended is WeightingEnded.CONTRADICTION
    assert np.count_nonzero(found.extra > STD**2) >= 1
    again = judged(seed, spoiled, size, 39)
    assert np.flatnonzero(again.extra > STD**2).tolist() == np.flatnonzero(found.extra > STD**2).tolist()


def test_what_does_not_settle_says_so() -> None:
    assert judged(3, 1, 10.0, 1).ended is WeightingEnded.UNFINISHED


@pytest.mark.slow
def test_nearly_all_campaigns_settle() -> None:
    """Up to five bad sweeps of 5 to 57: the share that contradicts itself, and that does not settle at all."""
    ended = [judged(seed, spoiled, size).ended for seed in range(60) for spoiled in (1, 2, 3, 5) for size in (1, 3, 10)]
    settled, contradiction = (
        ended.count(kind) / len(ended) for kind in (WeightingEnded.SETTLED, WeightingEnded.CONTRADICTION)
    )
    print(f"settled {100 * settled:.1f} %, contradiction {100 * contradiction:.1f} %")
    assert settled > 0.95
    assert settled + contradiction > 0.995
