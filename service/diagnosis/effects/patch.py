"""The contribution of an effect to a scenario, in the format of the scenario (docs/reference/scenario.md).

"train" and "measurement" belong to the axis, "links" to the robot. To merge patches, numbers are added and lists are
concatenated. All torques are as recorded; `scenario.axis_entry` corrects the rest for a wrong torque constant.
"""

from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np

Patch = dict[str, Any]


class Inexpressible(Exception):
    """A parameter has a value that no scenario can contain; the text names it."""


def positive(parameters: Mapping[str, float], name: str) -> float:
    """The value of a parameter; Inexpressible if it is not above 0."""
    if parameters[name] <= 0:
        raise Inexpressible(f"{name} = {parameters[name]:.3g} is not above 0")
    return parameters[name]


def dry(forward: float, backward: float | None = None, **more: Any) -> Patch:
    """Dry friction of the motor, N m; the same in both directions unless `backward` is given."""
    other = forward if backward is None else backward
    return {"train": {"motor_friction": {"coulomb": forward, "backward_coulomb": other} | more}}


def ripples(parameters: Mapping[str, float], orders: Sequence[float]) -> list[dict[str, float]]:
    """``A sin(o theta) + B cos(o theta)`` of each order as amplitude and phase."""
    pairs = [(order, parameters[f"sine_{order:g}"], parameters[f"cosine_{order:g}"]) for order in orders]
    return [
        {"order": order, "amplitude": float(np.hypot(sine, cosine)), "phase": float(np.arctan2(cosine, sine))}
        for order, sine, cosine in pairs
    ]


def merged(first: Mapping[str, Any], second: Mapping[str, Any]) -> Patch:
    """Both patches: numbers added, lists concatenated, all other values from the second."""
    result = dict(first)
    for key, value in second.items():
        old = result.get(key)
        if isinstance(value, Mapping):
            result[key] = merged(old or {}, cast(Patch, value))
        elif isinstance(value, list):
            result[key] = [*(old or []), *value]
        else:
            result[key] = value if old is None else old + value
    return result
