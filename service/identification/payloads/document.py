"""A payload as JSON-able data: what `sweepid payload --json` writes."""

from typing import Any

import numpy as np

from service.identification.payloads.payload import Payload, body_of
from service.robot import INERTIAL_NAMES, Robot

CENTER = ("x", "y", "z")


def payload_document(robot: Robot, found: Payload) -> dict[str, Any]:
    """SI, in the frame of the last joint; `inertia` about the centre of mass. What was not excited has value null."""
    figures = [
        {
            "value": float(value) if excited else None,
            "std": float(std) if excited else None,
            "std_total": float(total) if excited else None,
            "excited": bool(excited),
        }
        for value, std, total, excited in zip(
            found.body, found.body_std, found.body_std_total, found.excited, strict=True
        )
    ]
    near = body_of(found.nearest)
    return {
        "link": robot.chain.joints[-1].link,
        "frame": robot.joints[-1],
        "mass": figures[0],
        "center": dict(zip(CENTER, figures[1:4], strict=True)),
        "inertia": dict(zip(INERTIAL_NAMES[4:], figures[4:], strict=True)),
        "parameters": {
            "names": list(INERTIAL_NAMES),
            "values": found.parameters.tolist(),
            "covariance": found.covariance.tolist(),
            "covariance_total": found.covariance_total.tolist(),
        },
        "physical": {
            "consistent": found.physical,
            "deviation_in_std": found.deviation,
            "nearest": {
                "mass": float(near[0]),
                "center": near[1:4].tolist(),
                "inertia": dict(zip(INERTIAL_NAMES[4:], near[4:].tolist(), strict=True)),
            },
        },
        "evidence": [{"axis": each.joint, "from": each.source} for each in found.evidence],
        "sentences": sentences(found),
    }


def sentences(found: Payload) -> list[str]:
    """What a person should know beside the numbers."""
    told: list[str] = []
    if not abs(found.parameters[0]) > 3 * np.sqrt(found.covariance[0, 0]) and found.excited[0]:
        told.append(f"No mass shows: {found.body[0]:.3g} kg, standard deviation {found.body_std[0]:.2g} kg.")
    missing = [
        name for name, seen in zip(("mass", *CENTER, *INERTIAL_NAMES[4:]), found.excited, strict=True) if not seen
    ]
    if missing:
        told.append(f"The motions do not excite {', '.join(missing)}: these stay unknown.")
    if not found.physical:
        away = f"{found.deviation:.1f} standard deviations away"
        told.append(f"No body has these ten numbers; the nearest physical one is {away}.")
    return told
