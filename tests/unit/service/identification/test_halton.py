"""Quasi-random points against those of SciPy."""

import numpy as np
import pytest
from scipy.stats import qmc

from service.identification.design.halton import spread_evenly


@pytest.mark.parametrize("dimensions", [1, 2, 6, 12])
def test_the_points_are_those_of_scipy_to_the_last_digit(dimensions: int) -> None:
    lower = -np.linspace(0.5, 3.0, dimensions)
    upper = np.linspace(1.0, 2.0, dimensions)
    expected = qmc.scale(qmc.Halton(dimensions, scramble=False).random(1000), lower, upper)
    np.testing.assert_array_equal(spread_evenly(1000, lower, upper), expected)


def test_the_first_points_by_hand() -> None:
    found = spread_evenly(5, np.zeros(2), np.ones(2))
    by_hand = [(0, 0), (1 / 2, 1 / 3), (1 / 4, 2 / 3), (3 / 4, 1 / 9), (1 / 8, 4 / 9)]
    np.testing.assert_allclose(found, by_hand, rtol=1e-15)
