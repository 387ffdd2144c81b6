"""Tail probabilities and quantiles of three distributions, as `scipy.stats` computes them.

`scipy.stats` itself takes 0.4 s to import, at each start of a process that checks data.
"""

from math import comb

import numpy as np
from scipy.special import gammaln, logsumexp, pdtr, pdtrik


def log_chi2_above(value: float, pairs: int) -> float:
    """Natural logarithm of the probability that chi2 of 2 `pairs` degrees of freedom exceeds a value >= 0.

    Closed form for even degrees of freedom (Abramowitz and Stegun, 26.4.21); it does not underflow. No pairs: 0.
    """
    if pairs == 0 or value == 0:
        return 0.0
    k = np.arange(pairs)
    return float(logsumexp(k * np.log(value / 2) - gammaln(k + 1)) - value / 2)


def poisson_quantile(probability: float, mean: float) -> int:
    """The smallest count that a Poisson variable does not exceed with that probability (< 1)."""
    count = int(np.ceil(float(pdtrik(probability, mean))))
    return count - 1 if count > 0 and float(pdtr(count - 1, mean)) >= probability else count  # rounding of the inverse


def hypergeometric_tail(least: int, population: int, marked: int, drawn: int) -> float:
    """Probability of at least `least` marked ones among `drawn` of a population."""
    counts = range(max(least, 0), min(marked, drawn) + 1)
    ways = sum(comb(marked, count) * comb(population - marked, drawn - count) for count in counts)
    return ways / comb(population, drawn)
