"""Greedy pose selection: against exhaustive SVD, its bounds, its criteria, its start while the matrix is singular."""

from itertools import islice

import numpy as np
import pytest

from service.identification.design.pose_selection import (
    RIDGE,
    SLACK,
    Criterion,
    choices,
    condition_bounds,
    condition_numbers,
)
from tests.naive_selection import naive_condition


def candidates(m: int, a: int, p: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(m, a, p)) * np.logspace(-3, 3, p)


def selected(
    rows: np.ndarray, count: int, criterion: Criterion = Criterion.CONDITION
) -> tuple[tuple[int, ...], tuple[float, ...]]:
    """Candidates in their order, and the condition number after each."""
    picks, condition = zip(*islice(choices(rows, criterion), count), strict=True)
    return picks, condition


def svd_condition(rows: np.ndarray, picks: tuple[int, ...]) -> float:
    scaled = rows / np.sqrt(np.sum(rows**2, axis=(0, 1)))
    singular = np.linalg.svd(scaled[list(picks)].reshape(-1, rows.shape[2]), compute_uv=False)
    return float(singular[0] / singular[-1])


def seldom(m: int, a: int, p: int) -> np.ndarray:
    """Rows of low variety, as those of a robot: a few directions are seldom seen."""
    rng = np.random.default_rng(p)
    return rng.normal(size=(m, a, p)) * rng.lognormal(sigma=1.5, size=(m, 1, 1)) * rng.lognormal(sigma=1.5, size=p)


CANDIDATES = {
    "one row a pose": (candidates(40, 1, 4), 12),
    "one parameter": (candidates(20, 1, 1), 10),
    "two parameters": (candidates(20, 1, 2), 10),
    "no pose shows the last parameter": (candidates(40, 1, 4) * [1, 1, 1, 0], 8),
    "symmetric, so that the first is taken": (np.concatenate([candidates(20, 2, 5), -candidates(20, 2, 5)]), 15),
    **{f"low variety {shape}": (seldom(*shape), 25) for shape in ((60, 3, 11), (60, 2, 9), (50, 1, 5), (40, 6, 4))},
}


@pytest.mark.parametrize("name", CANDIDATES)
def test_each_step_takes_what_an_svd_of_every_candidate_takes(name: str) -> None:
    """Bounds spare work and change no pick."""
    rows, count = CANDIDATES[name]
    found, told = selected(rows, count)
    picks, condition = naive_condition(rows, count)
    assert list(found) == picks
    assert told == pytest.approx(condition, rel=1e-6)


def test_start_reaches_full_rank_with_the_fewest_poses() -> None:
    # every candidate but three repeats the same row; 3 parameters need all three odd ones within 3 picks
    rows = np.tile(np.array([[1.0, 1.0, 1.0]]), (50, 1, 1))
    rows[7], rows[23], rows[41] = [[1.0, 0, 0]], [[0, 1.0, 0]], [[0, 0, 1.0]]
    _, condition = selected(rows, 5)
    assert np.isinf(condition[:2]).all()
    assert np.isfinite(condition[2:]).all()


def test_no_pose_twice_and_the_same_again() -> None:
    rows = candidates(30, 2, 5)
    first = selected(rows, 30)
    assert sorted(first[0]) == list(range(30))
    assert selected(rows, 30) == first


def test_units_of_a_column_do_not_matter() -> None:
    rows = candidates(60, 1, 5)
    assert selected(rows * np.array([1e-3, 1, 1e3, 1, 7]), 15)[0] == selected(rows, 15)[0]


@pytest.mark.parametrize("width", [1, 3])
def test_a_bound_is_one(width: int) -> None:
    rows = candidates(200, 2, 8)
    rows = rows / np.sqrt(np.sum(rows**2, axis=(0, 1)))
    gram = np.einsum("iap,iaq->pq", rows[:30], rows[:30])
    bound = condition_bounds(rows, *np.linalg.eigh(gram), width)
    exact = condition_numbers(np.asarray(np.linalg.eigvalsh(gram + rows.swapaxes(1, 2) @ rows), dtype=float))
    assert np.all(bound <= exact * (1 + 1e-12))
    assert np.median(bound / exact) > 0.7


def test_d_optimal_takes_the_largest_determinant() -> None:
    rows = candidates(80, 2, 6)
    picks, _ = selected(rows, 20, Criterion.D_OPTIMAL)
    scaled = rows / np.sqrt(np.sum(rows**2, axis=(0, 1)))
    ridge = RIDGE * np.sum(scaled**2) / 80 / 6 * np.eye(6)
    for k in range(20):
        before = picks[:k]

        def volume(i: int, before: tuple[int, ...] = before) -> float:
            stacked = scaled[[*before, i]].reshape(-1, 6)
            return float(np.linalg.slogdet(stacked.T @ stacked + ridge)[1])

        rest = [i for i in range(80) if i not in before]
        assert volume(picks[k]) >= max(map(volume, rest)) - 1e-7


def test_travel_takes_the_nearest_of_the_well_conditioned() -> None:
    rows = candidates(100, 2, 5)
    poses = np.random.default_rng(1).uniform(-1, 1, (100, 3))
    home = np.zeros(3)
    chosen = list(islice(choices(rows, Criterion.CONDITION_AND_TRAVEL, poses, home), 30))
    picks = tuple(pick for pick, _ in chosen)
    for k in range(6, 30):
        before = picks[:k]
        been = np.vstack([home, poses[list(before)]])
        condition = {i: svd_condition(rows, (*before, i)) for i in range(100) if i not in before}
        away = {i: float(np.abs(been - poses[i]).sum(axis=1).min()) for i in condition}
        near = [i for i in condition if condition[i] <= SLACK * min(condition.values())]
        assert picks[k] in near
        assert away[picks[k]] == pytest.approx(min(away[i] for i in near))
        assert chosen[k][1] == pytest.approx(condition[picks[k]], rel=1e-6)
    with pytest.raises(ValueError, match="needs the poses"):
        selected(rows, 5, Criterion.CONDITION_AND_TRAVEL)


def test_a_candidate_that_is_refused_leaves_its_place_to_the_next() -> None:
    rows = candidates(30, 1, 4)
    asked: list[int] = []

    def accept(pick: int) -> bool:
        asked.append(pick)
        return pick % 3 != 0

    picks = [pick for pick, _ in choices(rows, Criterion.CONDITION, accept=accept)]
    assert picks == [pick for pick in asked if pick % 3 != 0]
    assert sorted(picks) == [k for k in range(30) if k % 3 != 0]
    assert sorted(asked) == list(range(30))
