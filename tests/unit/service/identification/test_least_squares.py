import numpy as np

from service.identification.least_squares import Information


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
