"""SciPy's iterative fits: how they ended is asked, not hoped for."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from service.errors import BadInput


class Fit(Protocol):
    """What `scipy.optimize.least_squares` gives."""

    x: NDArray[np.float64]
    cost: float
    success: bool
    message: str


def converged(found: Fit, place: str, what: str) -> None:
    """BadInput at `place` unless SciPy's result `found`, the fit of `what`, is a converged and finite minimum."""
    if not np.isfinite(found.cost):
        raise BadInput(place, f"the fit of {what} has no finite residual")
    if not found.success:
        raise BadInput(place, f"the fit of {what} did not converge: {' '.join(found.message.split())}")
