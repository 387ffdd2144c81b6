"""Greedy pose selection: against exhaustive SVD, its bounds, its criteria, its start while the matrix is singular."""

from itertools import islice

import numpy as np
import pytest

from service.identification.design.pose_selection import (
    Assumed,
    Criterion,
    PoseLimits,
    PredictedConfidence,
    choices,
    condition_bounds,
    condition_numbers,
    needed,
    sweep_information,
    without_gain,
)
from service.model import Sine
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
    ridge = PoseLimits.ridge * np.sum(scaled**2) / 80 / 6 * np.eye(6)
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
        near = [i for i in condition if condition[i] <= PoseLimits.slack * min(condition.values())]
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


SINES = tuple(Sine(frequency=f, amplitude=a, phase=0.0) for f, a in ((2.0, 0.003), (3.0, 0.002), (5.0, 0.001)))
RATED, DURATION, LOAD = 3000.0, 5.0, 150.0


def rows_of_lines(stiffness_sigma: float) -> np.ndarray:
    """Whitened rows of Im Z in [J, c, k_g], and the prior of k_g as one row more."""
    omega = 2 * np.pi * np.array([sine.frequency for sine in SINES])
    amplitude = np.array([sine.amplitude for sine in SINES])
    samples = Assumed.noise_rate * DURATION
    std = Assumed.effort_noise * RATED * np.sqrt(2 / samples) / amplitude
    rows = np.stack([omega, omega**3 * LOAD**2, -1 / omega], -1) / std[:, None]
    return np.vstack([rows, [0, 0, 1 / stiffness_sigma]])


def test_an_unknown_gravity_stiffness_costs_what_it_costs_in_least_squares() -> None:
    rows = rows_of_lines(200.0)
    whole = np.linalg.inv(rows.T @ rows)[:2, :2]
    information = sweep_information(SINES, DURATION, RATED, LOAD, 200.0)
    assert np.linalg.inv(information) == pytest.approx(whole, rel=1e-6)


def test_near_the_locked_rotor_frequency_more_is_seen() -> None:
    rigid = sweep_information(SINES[:1], DURATION, RATED, LOAD, 1.0)
    elastic = sweep_information(SINES[:1], DURATION, RATED, LOAD, 1.0, locked_rotor=4.0)
    assert elastic[0, 0] == pytest.approx(rigid[0, 0] / (1 - 0.25) ** 4, rel=1e-3)


def test_confidence_is_that_of_the_whole_least_squares() -> None:
    """Two axes, three base parameters, six poses; all rows stacked and inverted at once."""
    rng = np.random.default_rng(0)
    rows, workspace = rng.normal(size=(6, 2, 3)), rng.normal(size=(50, 2, 3))
    inertia = rng.uniform(50, 200, (50, 2))
    about = rng.normal(size=(6, 2, 4, 2)) * [10.0, 1e6]  # whitened rows of [J, c]
    information = about.swapaxes(-1, -2) @ about
    predicted = PredictedConfidence(workspace, inertia, np.ones(3))
    percent = []
    for row, own in zip(rows, information, strict=True):
        predicted.add(row, own)
        percent.append(predicted.percent())
    prior = np.median(inertia, axis=0) * (2 * np.pi * Assumed.softest) ** 2
    stacked = [np.concatenate([np.zeros(3), one]) for one in np.diag(prior)]
    for pose in range(6):
        for axis in range(2):
            for inertia_part, compliance_part in about[pose, axis]:
                row = np.zeros(5)
                row[:3] = inertia_part * rows[pose, axis]
                row[3 + axis] = compliance_part
                stacked.append(row)
    whole = np.array(stacked)
    covariance = np.linalg.inv(whole.T @ whole)[:3, :3]
    std = np.sqrt(np.einsum("wai,ij,waj->wa", workspace, covariance, workspace))
    assert percent[-1] == pytest.approx(100 * float((std / inertia).max()), rel=1e-6)
    assert percent[0] == np.inf  # two rows, three parameters
    assert percent[1:] == sorted(percent[1:], reverse=True)


def test_a_parameter_is_determined_where_the_sweeps_are_better_than_the_model() -> None:
    """One axis; each of two parameters has its own pose, and the compliance is known from its prior."""
    rows = np.eye(2)[:, None, :]
    workspace, inertia = np.ones((1, 1, 2)), np.full((1, 1), 100.0)
    predicted = PredictedConfidence(workspace, inertia, np.array([2.0, 2.0]))
    for row, std in zip(rows, (1.9, 2.1), strict=True):
        predicted.add(row, np.diag([std**-2, 0.0])[None])
    assert predicted.solution().determined.tolist() == [True, False]
    assert np.isfinite(predicted.percent())  # of the sweeps alone
    predicted.add(rows[1], np.diag([2.1**-2, 0.0])[None])
    assert predicted.solution().determined.tolist() == [True, True]


def test_confidence_and_open_parameters_are_told_by_axis() -> None:
    """Two axes; J of the first is b1, of the second b1 + b2; b1 is known to 1, b2 to 2 kg m^2."""
    rows = np.array([[[1.0, 0.0], [1.0, 1.0]]])
    predicted = PredictedConfidence(rows, np.full((1, 2), 100.0), np.array([5.0, 5.0]))
    stiff = np.diag([0.0, 1e30])  # compliance known
    predicted.add(np.eye(2), np.array([np.diag([1.0, 0.0]), np.diag([0.25, 0.0])]) + stiff)
    assert predicted.percent_by_axis() == pytest.approx([1.0, np.sqrt(5.0)])
    assert predicted.percent() == pytest.approx(np.sqrt(5.0))
    assert predicted.depending(np.array([True, False])).tolist() == [True, True]
    assert predicted.depending(np.array([False, True])).tolist() == [False, True]


def test_poses_that_a_confidence_does_not_need_are_found_from_the_last() -> None:
    """One parameter, which each pose shows with the std 2; two poses give 1.41 %, three 1.15 %."""
    pose = (np.ones((1, 1)), np.diag([0.25, 0.0])[None])
    predicted = PredictedConfidence(np.ones((1, 1, 1)), np.full((1, 1), 100.0), np.array([9.0]))
    for _ in range(5):
        predicted.add(*pose)
    assert needed(predicted, [pose] * 5, 1.2) == [0, 1, 2]
    assert predicted.percent() == pytest.approx(2 / np.sqrt(3))
    assert needed(predicted, [pose] * 3, 1.0) == [0, 1, 2]  # out of reach: all


def test_a_compliance_that_the_sweeps_must_find_costs_precision() -> None:
    """With correlation 0.8 of J and c, and c free, the variance of J is 1 / (1 - 0.64) of the one with c known."""
    softest = 1 / (100.0 * (2 * np.pi * Assumed.softest) ** 2)
    scale = np.diag([1.0, 1e6 / softest])  # c is found much better than its prior
    about = scale @ np.array([[1.0, 0.8], [0.8, 1.0]]) @ scale
    for spread, determined in ((1.6, False), (1.7, True)):  # 1 / 0.6 = 1.67
        predicted = PredictedConfidence(np.ones((1, 1, 1)), np.full((1, 1), 100.0), np.array([spread]))
        predicted.add(np.ones((1, 1)), about[None])
        assert predicted.solution().determined.tolist() == [determined]


def test_a_pose_that_sees_nothing_new_adds_nothing() -> None:
    assert without_gain([np.inf, np.inf, 2.0, 1.5, 1.499, 1.2]) == [4]
    # noise that averages out is a gain
    assert without_gain([1 / np.sqrt(n) for n in range(1, 300)]) == []
