"""How certain a number of an estimate must be to be used."""

import math

import numpy as np

from service.results.estimate import BaseParameter, EstimatedAxis

UNSURE = 0.25  # of the value: with a larger standard deviation it is not for use


def share_of_value(axis: EstimatedAxis) -> float:
    """Standard deviation of an axis' inertia over its value, that of the torque constant included.

    Of the model over the workspace where it is known, else the median of the sweeps.
    """
    if axis.confidence_percent is not None:
        share = axis.confidence_percent / 100
    else:
        share = float(np.median([sweep.std / abs(sweep.value) for sweep in axis.inertia]))
    gain = axis.torque_gain
    return math.hypot(share, (gain.std or 0.0) / gain.value)


def not_for_use(parameter: BaseParameter) -> str:
    """Why the value of a base parameter should not be used, or ""."""
    if parameter.std is None:
        return "not identified"
    return "too uncertain" if parameter.std > UNSURE * abs(parameter.value) else ""
