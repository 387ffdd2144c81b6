"""Quasi-random points against those of SciPy."""

import numpy as np
import pytest
from scipy.stats import qmc

from service.identification.model.base_parameters import spread_evenly


@pytest.mark.parametrize("dimensions", [1, 2, 6, 12])
def test_the_points_are_those_of_scipy_to_the_last_digit(dimensions: int) -> None:
    lower = -np.linspace(0.5, 3.0, dimensions)
    upper = np.linspace(1.0, 2.0, dimensions)
    expected = qmc.scale(qmc.Halton(dimensions, scramble=False).random(1000), lower, upper)
    np.testing.assert_array_equal(spread_evenly(1000, lower, upper), expected)
