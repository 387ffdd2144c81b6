"""Greedy pose selection: against exhaustive SVD, and its start while the matrix is singular."""

import time

import numpy as np
import pytest

from service.errors import BadInput
from service.identification.pose_selection import select_poses


def candidates(m: int, a: int, p: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(m, a, p)) * np.logspace(-3, 3, p)


def svd_condition(rows: np.ndarray, picks: tuple[int, ...]) -> float:
    scaled = rows / np.sqrt(np.sum(rows**2, axis=(0, 1)))
    singular = np.linalg.svd(scaled[list(picks)].reshape(-1, rows.shape[2]), compute_uv=False)
    return float(singular[0] / singular[-1])


def test_each_step_takes_what_an_svd_of_every_candidate_takes() -> None:
    rows = candidates(40, 1, 4)
    chosen = select_poses(rows, 12)
    for k in range(4, 12):
        before = chosen.picks[:k]
        rest = [i for i in range(40) if i not in before]
        best = min(rest, key=lambda i: svd_condition(rows, (*before, i)))
        assert chosen.picks[k] == best
        assert chosen.condition[k] == pytest.approx(svd_condition(rows, (*before, best)), rel=1e-6)


def test_start_reaches_full_rank_with_the_fewest_poses() -> None:
    # every candidate but three repeats the same row; 3 parameters need all three odd ones within 3 picks
    rows = np.tile(np.array([[1.0, 1.0, 1.0]]), (50, 1, 1))
    rows[7], rows[23], rows[41] = [[1.0, 0, 0]], [[0, 1.0, 0]], [[0, 0, 1.0]]
    chosen = select_poses(rows, 5)
    assert np.isinf(chosen.condition[:2]).all()
    assert np.isfinite(chosen.condition[2:]).all()


def test_no_pose_twice_and_the_same_again() -> None:
    rows = candidates(30, 2, 5)
    first = select_poses(rows, 30)
    assert sorted(first.picks) == list(range(30))
    assert select_poses(rows, 30) == first


def test_units_of_a_column_do_not_matter() -> None:
    rows = candidates(60, 1, 5)
    assert select_poses(rows * np.array([1e-3, 1, 1e3, 1, 7]), 15).picks == select_poses(rows, 15).picks


def test_more_poses_than_candidates_is_refused() -> None:
    with pytest.raises(BadInput, match="24 wanted, but only 5"):
        select_poses(candidates(5, 1, 3), 24)


def test_the_grid_of_two_axes_takes_seconds() -> None:
    rows = candidates(1728, 3, 11)
    start = time.perf_counter()
    select_poses(rows, 24)
    assert time.perf_counter() - start < 10.0
