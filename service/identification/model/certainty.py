"""Required certainty of a value of an estimate."""

import math

import numpy as np

from service.model.results.estimate import BaseParameter, EstimatedAxis

UNSURE = 0.25  # of the value: a value with a larger standard deviation should not be used


def share_of_value(axis: EstimatedAxis) -> float:
    """Standard deviation of an axis' inertia relative to its value, including the torque constant; inf for a value of
    0.

    That of the model over the workspace if it is known, otherwise the median of the sweeps.
    """
    if axis.confidence_percent is not None:
        share = axis.confidence_percent / 100
    else:
        share = float(np.median([_share(sweep.std, sweep.value) for sweep in axis.inertia]))
    gain = axis.torque_gain
    return math.hypot(share, _share(gain.std, gain.value))


def _share(std: float, value: float) -> float:
    return std / abs(value) if value else math.inf


def not_for_use(parameter: BaseParameter) -> str:
    """Why the value of a base parameter should not be used, or ""."""
    if parameter.std is None:
        return "not identified"
    return "too uncertain" if parameter.std > UNSURE * abs(parameter.value) else ""
