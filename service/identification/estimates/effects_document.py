"""Which known effects entered an estimate, and how: "effects" and "model" of its document."""

from collections.abc import Sequence
from typing import Any

from service.identification.axis.axis_estimate import AxisEstimate
from service.identification.axis.known_effects import DELAY, ELASTICITY, GAIN, HOSE, KnownEffect, KnownEffects
from service.identification.axis.known_torque import LAWS

ENTERS = {
    DELAY: "effort is taken earlier by the delay",
    ELASTICITY: "prior of the spring, beside the data sheet",
    HOSE: "stiffness beside gravity's",
    GAIN: "effort is divided by the gain",
    **dict.fromkeys(LAWS, "its torque at the measured velocity is taken out of the effort"),
}
STAYS_OUT = {
    "effort_offset": "a constant shows at no line, and records without lines fit one anyway",
    "cogging_torque": "ripple of known orders is fitted in every sweep",
    "transmission_error": "ripple of known orders is fitted in every sweep",
    "gravity_error": "gravity is fitted in every sweep",
    "payload": "the inertias hold whatever the robot carries",
}
OTHER = "is not described for sweeps with lines"


def effects_document(known: KnownEffects, axes: Sequence[AxisEstimate]) -> dict[str, Any]:
    """{"effects", "model"}: every known effect of the estimate's axes with the values used; where they are from."""
    return {
        "effects": [
            {
                "axis": axis.joint,
                "effect": effect.name,
                "parameters": {
                    name: {"value": value, "std": effect.std[name], "unit": effect.units[name]}
                    for name, value in effect.values.items()
                },
                **_role(effect, axis),
            }
            for axis in axes
            for effect in known.of(axis.joint).effects
        ],
        "model": dict(known.source) or None,
    }


def _role(effect: KnownEffect, axis: AxisEstimate) -> dict[str, Any]:
    """`used`, and how or why not."""
    if effect.unusable:
        return {"used": False, "how": effect.unusable}
    if effect.name == GAIN:
        used = axis.gain.gain == 1 + effect.values.get("gain_error", 0.0)
        return {"used": used, "how": ENTERS[GAIN] if used else "a test mass calibrated the axis"}
    if effect.name in ENTERS:
        if axis.fit is None:
            return {"used": False, "how": "the axis has no sweep with lines"}
        return {"used": True, "how": ENTERS[effect.name]}
    return {"used": False, "how": STAYS_OUT.get(effect.name, OTHER)}
