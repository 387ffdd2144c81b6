"""Checks the start and the end of the iterative fits."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from service.model.errors import BadInput

UNSETTLED = 0.05  # relative change of a noise estimate in the last round of reweighting: a warning above


class Fit(Protocol):
    """Result of `scipy.optimize.least_squares`."""

    x: NDArray[np.float64]
    cost: float
    success: bool
    message: str


def finite(values: NDArray[np.float64] | NDArray[np.complex128], place: str, what: str) -> None:
    """BadInput at `place` where one of `values`, any shape, is NaN or infinite; `what` names them.

    Called before a fit: for such a start SciPy raises an error without axis and sweep, and linear
    solvers return NaN.
    """
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        raise BadInput(
            place, f"{bad.size} of {values.size} values of {what} are not finite, the first is number {bad[0]}"
        )


def unsettled(change: float) -> str | None:
    """The warning if a noise estimate still changes in the last round of reweighting; `change` is relative."""
    if change <= UNSETTLED:
        return None
    return f"its noise still changes by {100 * change:.0f} % in the last round; limit {100 * UNSETTLED:.0f} %"


def converged(found: Fit, place: str, what: str) -> None:
    """Raises BadInput at `place` unless SciPy's result `found`, the fit of `what`, is a converged and finite
    minimum.
    """
    if not np.isfinite(found.cost):
        raise BadInput(place, f"the fit of {what} has no finite residual")
    if not found.success:
        raise BadInput(place, f"the fit of {what} did not converge: {' '.join(found.message.split())}")
