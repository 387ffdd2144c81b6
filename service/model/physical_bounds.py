"""What no machine with drives can be: the one table of bounds for numbers that come from outside, SI on the joint side.

Each bound lies at least a factor of ten beyond the largest machine that is known for it, so that it refuses only a
wrong unit, a wrong digit or a damaged file. `sweepid check` and `sweepid robot check` tell what is merely unusual.
"""

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from service import BadInput
from service.model.arrays import Array
from service.model.urdf import Chain, inertia_at_centre


@dataclass(frozen=True)
class Most:
    """Largest magnitudes that are believed, SI on the joint side."""

    position: float = 1e5  # rad (m): 16,000 turns; rails of cranes and telescopes are below 1 km
    velocity: float = 1e4  # rad/s (m/s): 95,000 rpm without a gear; a fast spindle makes 60,000
    limit: float = 1e6  # rad/s (m/s): makers who do not want to limit a velocity in a URDF write up to this
    effort: float = 1e9  # N m (N): a thousand times the slewing drive of the largest excavator, about 1e6 N m
    frequency: float = 1e6  # Hz: current controllers switch at 1e5 Hz at most
    time: float = 1e10  # s: 300 years
    mass: float = 1e7  # kg: a bucket-wheel excavator weighs 1.4e7 kg as a whole, its boom 1e6 kg
    length: float = 1e4  # m
    inertia: float = 1e13  # kg m^2: the largest mass at 1 km
    viscous: float = 1e12  # N m s/rad (N s/m)
    gravity: float = 1e5  # m/s^2: `check` tells gravity in mm/s^2, which is below this
    ratio: float = 1e9  # motor revolutions per joint revolution; rad per m


Position = Annotated[float, Field(ge=-Most.position, le=Most.position)]
Velocity = Annotated[float, Field(ge=-Most.velocity, le=Most.velocity)]

_COLUMNS = {"time": Most.time, "position": Most.position, "velocity": Most.velocity, "effort": Most.effort}
_URDF: dict[str, dict[str, float]] = {
    "origin": {"xyz": Most.length, "rpy": Most.position},
    "mass": {"value": Most.mass},
    "inertia": dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), Most.inertia),
    "axis": {"xyz": Most.length},
    "limit": {"lower": Most.position, "upper": Most.position, "velocity": Most.limit, "effort": Most.effort},
    "dynamics": {"damping": Most.viscous, "friction": Most.effort},
    "box": {"size": Most.length},
    "cylinder": {"radius": Most.length, "length": Most.length},
    "capsule": {"radius": Most.length, "length": Most.length},
    "sphere": {"radius": Most.length},
}
"""Largest absolute values of attributes."""


def most_of_column(name: str) -> float:
    """Largest absolute value in a column of a recording."""
    return next((most for kind, most in _COLUMNS.items() if kind in name), 1e4)  # deg C


def check_urdf(text: str, chain: Chain, place: str) -> None:
    """BadInput for a URDF that describes no possible body: a number that is not finite or beyond its bound, a negative
    mass, or a moving link (with what is fixed to it) with a negative principal inertia. A link without mass is a
    placeholder of its maker and allowed: `sweepid robot check` tells it. `chain`: of the same text.
    """
    for here, element in _elements(ET.fromstring(text), place):
        for name, most in _URDF.get(element.tag, {}).items():
            for part in element.get(name, "").split():
                _check(
                    part,
                    most,
                    f"{here} {element.tag} {name}",
                    lowest=0.0 if name in ("value", "velocity", "effort", "size", "radius", "length") else -most,
                )
    for joint, parameters in zip(chain.joints, chain.inertial, strict=True):
        _check_body(parameters, f"{place} link {joint.link}")


def _elements(root: ET.Element, place: str) -> Iterator[tuple[str, ET.Element]]:
    """All elements of links and joints, each with the name of the link or joint."""
    for part in root:
        if part.tag in ("link", "joint"):
            here = f"{place} {part.tag} {part.get('name')}"
            yield from ((here, element) for element in part.iter())


def _check(text: str, most: float, here: str, *, lowest: float) -> None:
    try:
        value = float(text)
    except ValueError:
        return  # not read by anybody: who reads it refuses it
    if not lowest <= value <= most or not math.isfinite(value):
        raise BadInput(here, f"{text} is not possible: limit {lowest:g} to {most:g}")


def _check_body(parameters: Array, here: str) -> None:
    """Positive semidefinite at the centre of mass. A principal inertia above the sum of the others is a usual mistake
    of CAD exports: `sweepid robot check` tells it.
    """
    if parameters[0] <= 0:
        return
    principal = np.linalg.eigvalsh(inertia_at_centre(parameters)).tolist()
    # digits that CAD programs drop
    if principal[0] < -0.01 * max(abs(principal[0]), abs(principal[2])):
        shown = ", ".join(f"{value:.4g}" for value in principal)
        raise BadInput(
            here, f"no body has its principal inertias {shown} kg m^2 at the centre of mass: one is negative"
        )
