"""SciPy's iterative fits: how they ended is asked, not hoped for."""

from typing import Any

import numpy as np

from service.errors import BadInput


def converged(found: Any, place: str, what: str) -> None:
    """BadInput at `place` unless SciPy's result `found`, the fit of `what`, is a converged and finite minimum."""
    if not np.isfinite(found.cost):
        raise BadInput(place, f"the fit of {what} has no finite residual")
    if not found.success:
        raise BadInput(place, f"the fit of {what} did not converge: {' '.join(str(found.message).split())}")
