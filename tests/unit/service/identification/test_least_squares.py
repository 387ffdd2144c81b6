from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares

from service import BadInput
from service.identification.estimates.estimate import identify
from service.identification.estimation import estimate_document
from service.identification.model import Information, LeftOut, converged
from service.identification.spectra.frequency_response import Spectrum, spectrum
from service.model import Robot, Sine, build_robot
from tests.formula_sweep import Turning, by_formula


def _problem(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rows = rng.normal(size=(40, 4)) * [1.0, 1e3, 1e-3, 10.0]
    root = rng.normal(size=(40, 40))
    return rows, rows @ np.array([1.0, 2.0, 3.0, 4.0]) + rng.normal(size=40), root @ root.T + np.eye(40)


def test_equals_generalised_least_squares() -> None:
    rows, values, covariance = _problem(np.random.default_rng(1))
    solution = Information.empty(4).add(rows, values, covariance).solve(np.zeros(4))
    weight = np.linalg.inv(covariance)
    expected = np.linalg.solve(rows.T @ weight @ rows, rows.T @ weight @ values)
    np.testing.assert_allclose(solution.values, expected, rtol=1e-8)
    np.testing.assert_allclose(solution.covariance, np.linalg.inv(rows.T @ weight @ rows), rtol=1e-6)


def test_what_the_data_do_not_determine_stays_at_the_start_and_is_called_so() -> None:
    rows = np.array([[1.0, 1.0, 0.0], [2.0, 2.0, 0.0], [0.0, 0.0, 3.0]])
    solution = Information.empty(3).add(rows, np.array([4.0, 8.0, 6.0]), np.eye(3)).solve(np.array([1.0, 1.0, 0.0]))
    np.testing.assert_allclose(solution.values, [2.0, 2.0, 2.0])  # the sum is known, the difference stays
    assert solution.determined.tolist() == [False, False, True]
    assert np.isinf(solution.std[:2]).all()
    assert solution.std[2] == 1 / 3


def test_a_value_is_settled_where_what_stays_at_the_start_hardly_matters() -> None:
    """The start's std is 2 for each of two parameters; the first is known to 0.1, of the second nothing."""
    spread = np.array([2.0, 2.0])
    solution = Information(np.diag([100.0, 0.0]), np.zeros(2)).solve(np.zeros(2), spread)
    assert solution.determined.tolist() == [True, False]
    np.testing.assert_allclose(np.abs(solution.kept), [[0.0], [2.0]], atol=1e-12)
    for share, determined in ((0.0, True), (0.0099, True), (0.0101, False), (1.0, False)):
        assert solution.determines(np.array([[1.0, 0.0], [1.0, share]]), spread) == determined


def test_left_out_equals_solving_without() -> None:
    """Each value, and five at once, against a fit of all others; the values are correlated in two blocks."""
    rng = np.random.default_rng(4)
    rows = rng.normal(size=(20, 3)) * [1.0, 1e3, 1e-3]
    roots = [rng.normal(size=(10, 10)) for _ in range(2)]
    blocks = [root @ root.T + np.eye(10) for root in roots]
    covariance = np.zeros((20, 20))
    covariance[:10, :10], covariance[10:, 10:] = blocks
    values = rows @ np.array([1.0, 2.0, 3.0]) + rng.normal(size=20)
    left_out = LeftOut.of(rows, values, blocks)
    error, variance = left_out.each()
    for members in [np.array([k]) for k in range(20)] + [np.array([0, 3, 9, 11, 19])]:
        rest = np.setdiff1d(np.arange(20), members)
        inner = np.linalg.inv(covariance[np.ix_(rest, rest)])
        normal = np.linalg.inv(rows[rest].T @ inner @ rows[rest])
        beta = normal @ rows[rest].T @ inner @ values[rest]
        # best prediction of correlated values: the model, and what the others' errors tell of theirs
        gain = covariance[np.ix_(members, rest)] @ inner
        expected = values[members] - rows[members] @ beta - gain @ (values[rest] - rows[rest] @ beta)
        away = rows[members] - gain @ rows[rest]
        own = covariance[np.ix_(members, members)] - gain @ covariance[np.ix_(rest, members)]
        told = left_out.together(members)
        assert told is not None
        np.testing.assert_allclose(told[0], expected, rtol=1e-7)
        np.testing.assert_allclose(told[1], own + away @ normal @ away.T, rtol=1e-7)
        if len(members) == 1:
            np.testing.assert_allclose([error[members[0]], variance[members[0]]], [told[0][0], told[1][0, 0]])


def test_a_value_that_no_other_tells_is_not_judged() -> None:
    rows = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    left_out = LeftOut.of(rows, np.array([1.0, 2.0, 5.0]), [np.eye(3)])
    error, variance = left_out.each()
    np.testing.assert_allclose(error, [-1.0, 1.0, 0.0])
    assert np.isinf(variance[2])
    assert left_out.together(np.array([2])) is None
    assert left_out.chi_squared(np.array([0, 1, 2])) == (pytest.approx(0.5), pytest.approx(1.0))


def rosenbrock(x: np.ndarray) -> np.ndarray:
    return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]])


def test_a_search_that_was_cut_short_is_refused() -> None:
    with pytest.raises(BadInput, match=r"^joint_1: the fit of a valley did not converge: The maximum number"):
        converged(least_squares(rosenbrock, [-1.2, 1.0], max_nfev=3), "joint_1", "a valley")


def test_what_is_no_number_is_refused() -> None:
    found = least_squares(rosenbrock, [-1.2, 1.0], method="lm")
    found.cost = np.nan
    with pytest.raises(BadInput, match=r"^joint_1: the fit of a valley has no finite residual"):
        converged(found, "joint_1", "a valley")


SINES = tuple(Sine(frequency=f, amplitude=0.004) for f in (2.0, 3.0, 5.0))
LIFTS = np.linspace(0.3, 0.34, 8)  # rad: too far apart to count as locked, too near to tell anything of the arm


def sweeps(robot: Robot, lifts: np.ndarray) -> list[Spectrum]:
    """`swing` with its model's inertia, made 12 % larger, in poses that differ by the lift alone."""
    found: list[Spectrum] = []
    for number, lift in enumerate(lifts):
        inertia = 1.12 * (15 + 3 * np.sin(lift) ** 2 + 40 * np.cos(lift) ** 2 + 150 * (0.3 + 1.2 * np.cos(lift)) ** 2)
        inertia += 170.0**2 * 0.002

        def effort(m: Turning, inertia: float = inertia, number: int = number) -> np.ndarray:
            noise = np.random.default_rng(number).normal(0, 3.0, len(m.time))
            return inertia * m.acceleration + 200 * m.velocity + noise

        fields = {"id": f"{number:04}", "axis": "swing", "pose": (0.0, lift), "offset_velocity": 0.02, "sines": SINES}
        found.append(spectrum(robot, by_formula(effort, 3.0, **fields, periods=3)))
    return found


def test_a_direction_hardly_excited_stays_with_the_model(robot: Robot) -> None:
    spectra = sweeps(robot, LIFTS)
    estimate = identify(robot, spectra)
    assert estimate.condition_number > 1e5
    document: dict[str, Any] = estimate_document(robot, spectra).as_json()
    open_ = [each for each in document["base_parameters"] if each["std"] is None]
    assert open_
    for each in open_:
        assert "the data do not determine it better than the nominal model" in each["reason"]
    start = estimate.base.combination @ np.concatenate([robot.chain.inertial.ravel(), [57.8, 57.8]])
    assert np.abs(estimate.solution.values - start).max() < 3 * estimate.spread.max()
    for link in document["standard_parameters"]["links"].values():
        assert max(map(abs, link.values())) < 1e3
    # and what the poses do tell is told: 12 % more inertia there than the model has
    axis = document["axes"]["swing"]
    assert axis["rmse_percent"]["identified_measured"] < 1.0
    assert axis["confidence_percent"] is None


@pytest.mark.parametrize("weak", [1e-3, 1e-6, 1e-12, 0.0])
def test_a_weak_direction_is_followed_only_where_data_beat_the_prior(weak: float) -> None:
    """By hand: two parameters, their sum measured to 1, their difference to 1/weak; the prior's spread is 10 each."""
    rows = np.array([[1.0, 1.0], [weak, -weak]])
    solution = Information.empty(2).add(rows, np.array([30.0, 5.0]), np.eye(2)).solve(np.zeros(2), np.full(2, 10.0))
    np.testing.assert_allclose(solution.values, [15.0, 15.0], rtol=1e-6)
    # the sum's half has std 1/2, the difference's half keeps the prior's 10/sqrt(2)
    np.testing.assert_allclose(np.diag(solution.covariance), 0.25 + 50.0, rtol=1e-6)
    assert np.isinf(solution.std).all()


def test_a_direction_that_data_tell_is_not_drawn_to_the_prior() -> None:
    rows = np.array([[1.0, 1.0], [1.0, -1.0]])
    solution = Information.empty(2).add(rows, np.array([30.0, 5.0]), np.eye(2)).solve(np.zeros(2), np.full(2, 10.0))
    np.testing.assert_allclose(solution.values, [17.5, 12.5])
    assert solution.determined.all()


def test_a_model_far_from_the_data_does_not_hold_them_back(robot: Robot) -> None:
    """Every inertia is a hundred times what the model says, under a prior of 30 %."""
    text = robot.urdf_text
    for number in ("200", "20", "15", "150", "3", "40"):
        text = text.replace(f'"{number}"', f'"{0.01 * float(number)}"')
    light = build_robot(robot.description, text)
    assert light.chain.inertial[1, 0] == pytest.approx(1.5)
    spectra = sweeps(robot, np.linspace(-1.3, 1.3, 8))
    assert estimate_document(light, spectra).axes["swing"].rmse_percent.identified_measured < 1.0
