r"""Residuals of a free motion are coloured: an autoregressive model of each axis whitens its equations.

    e_t = r_t - sum_j a_j r_(t-j),   j <= ORDER         (Yule-Walker, Levinson's recursion)

The first samples of an interval have fewer predecessors and use the predictor of lower order with its larger variance,
so an interval of any length is whitened without loss. Intervals end where an axis rests.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ORDER = 6


@dataclass(frozen=True)
class Colour:
    """Predictors of order 0 to p: `coefficients` (p + 1, p), of the samples 1 to p before; `std` (p + 1,) of errors."""

    coefficients: Array
    std: Array

    @classmethod
    def of(cls, stretches: list[Array], least: float, freedom: float, order: int = ORDER) -> "Colour":
        """From residuals (m_i,) of all intervals; `freedom`: samples minus fitted parameters, `least`: smallest std."""
        order = min(order, max(len(stretch) for stretch in stretches) - 1)
        lags = np.array(
            [sum(float(x[lag:] @ x[: len(x) - lag]) for x in stretches if len(x) > lag) for lag in range(order + 1)]
        )
        lags /= max(freedom, 1.0)
        lags[0] = max(lags[0] * (1 + 1e-9), least**2)
        return cls(*_levinson(lags))

    def whiten(self, signals: Array) -> Array:
        """For one interval (m, ...): prediction errors over their standard deviation."""
        white = np.empty_like(signals)
        for k in range(len(signals)):
            order = min(k, len(self.std) - 1)
            if order == len(self.std) - 1:
                white[k:] = self._full(signals, k)
                break
            predicted = np.tensordot(self.coefficients[order, :order], signals[:k][::-1], axes=1)
            white[k] = (signals[k] - predicted) / self.std[order]
        return white

    def _full(self, signals: Array, order: int) -> Array:
        errors = signals[order:].copy()
        for lag, coefficient in enumerate(self.coefficients[order, :order], start=1):
            errors -= coefficient * signals[order - lag : len(signals) - lag]
        return errors / self.std[order]


def stretches(sound: NDArray[np.bool_]) -> list[slice]:
    """The intervals of consecutive usable samples."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], sound.astype(int), [0]])))
    return [slice(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _levinson(lags: Array) -> tuple[Array, Array]:
    """Predictors of all orders and the standard deviations of their errors, from autocovariances (p + 1,)."""
    order = len(lags) - 1
    coefficients, variance = np.zeros((order + 1, order)), np.full(order + 1, lags[0])
    for k in range(1, order + 1):
        before = coefficients[k - 1, : k - 1]
        reflection = (lags[k] - before @ lags[1:k][::-1]) / variance[k - 1]
        coefficients[k, : k - 1] = before - reflection * before[::-1]
        coefficients[k, k - 1] = reflection
        variance[k] = variance[k - 1] * (1 - reflection**2)
    return coefficients, np.sqrt(variance)
