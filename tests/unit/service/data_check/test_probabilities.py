"""Probabilities of the check of the data against `scipy.stats`."""

import numpy as np
import pytest
from scipy.stats import chi2, hypergeom, poisson

from service.data_check.probabilities import hypergeometric_tail, log_chi2_above, poisson_quantile


@pytest.mark.parametrize("pairs", [1, 2, 7, 60])
def test_logarithm_of_the_upper_tail_of_chi2(pairs: int) -> None:
    for value in (0.0, 0.3, 2.0 * pairs, 40.0, 700.0):
        assert log_chi2_above(value, pairs) == pytest.approx(float(chi2.logsf(value, 2 * pairs)), rel=1e-9, abs=1e-12)


def test_far_out_the_logarithm_of_chi2_does_not_underflow() -> None:
    """By hand: with two degrees of freedom the tail is exp(-x / 2)."""
    assert log_chi2_above(5000.0, 1) == pytest.approx(-2500.0)
    assert log_chi2_above(5000.0, 0) == 0.0


@pytest.mark.parametrize("mean", [0.4, 1.5, 17.0, 260.0])
def test_quantile_of_poisson(mean: float) -> None:
    exactly = [float(poisson.cdf(count, mean)) for count in range(5)]  # where rounding of the inverse decides
    for probability in (0.0001, 0.5, 0.99, 1 - 1e-6, *exactly):
        if probability < 1:
            assert poisson_quantile(probability, mean) == int(poisson.ppf(probability, mean)), probability


@pytest.mark.slow
def test_upper_tail_of_the_hypergeometric_distribution() -> None:
    numbers = np.random.default_rng().integers(1, 30, (200, 2))
    for marked, others in numbers:
        population = int(marked + others)
        drawn = int(np.random.default_rng().integers(1, population + 1))
        for least in range(drawn + 2):
            expected = float(hypergeom.sf(least - 1, population, marked, drawn))
            assert hypergeometric_tail(least, population, int(marked), drawn) == pytest.approx(expected, abs=1e-12)
