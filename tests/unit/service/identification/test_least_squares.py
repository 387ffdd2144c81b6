import numpy as np
import pytest

from service.identification.model.least_squares import Information, LeftOut


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


def test_batches_may_come_in_any_order() -> None:
    rng = np.random.default_rng(2)
    batches = [(rng.normal(size=(3, 4)), rng.normal(size=3), np.diag(rng.uniform(1, 2, 3))) for _ in range(5)]
    forward = backward = Information.empty(4)
    for batch in batches:
        forward = forward.add(*batch)
    for batch in reversed(batches):
        backward = backward.add(*batch)
    assert forward.count == backward.count == 15
    np.testing.assert_allclose(
        forward.solve(np.zeros(4)).values, backward.solve(np.zeros(4)).values, rtol=1e-10, atol=1e-12
    )


def test_what_the_data_do_not_determine_stays_at_the_start_and_is_called_so() -> None:
    rows = np.array([[1.0, 1.0, 0.0], [2.0, 2.0, 0.0], [0.0, 0.0, 3.0]])
    solution = Information.empty(3).add(rows, np.array([4.0, 8.0, 6.0]), np.eye(3)).solve(np.array([1.0, 1.0, 0.0]))
    np.testing.assert_allclose(solution.values, [2.0, 2.0, 2.0])  # the sum is known, the difference stays
    assert solution.determined.tolist() == [False, False, True]
    assert np.isinf(solution.std[:2]).all()
    assert solution.std[2] == 1 / 3


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
