"""How certain a number of an estimate must be to be used."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

UNSURE = 0.25  # of the value: with a larger standard deviation it is not for use


def share_of_value(axis: Mapping[str, Any]) -> float:
    """Standard deviation of an axis' inertia over its value, that of the torque constant included.

    `axis` of the estimate's document: of the model over the workspace where it is known, else the median of the sweeps.
    """
    confidence, gain = axis.get("confidence_percent"), axis.get("torque_gain", {"value": 1.0, "std": 0.0})
    if confidence is not None:
        share = float(confidence) / 100
    else:
        share = float(np.median([sweep["std"] / abs(sweep["value"]) for sweep in axis["inertia"]]))
    return math.hypot(share, gain["std"] / gain["value"])


def not_for_use(parameter: Mapping[str, Any]) -> str:
    """Why the value of a base parameter (entry of the estimate's document) should not be used, or ""."""
    value, std = parameter["value"], parameter["std"]
    if std is None:
        return "not identified"
    return "too uncertain" if std > UNSURE * abs(value) else ""
