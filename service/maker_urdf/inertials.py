"""Links without mass: completed from the volume of their collision shapes, with a finding.

The density is the mean of complete arms, including motors, gears and cavities in their hulls. From their URDFs: UR5
1377, UR10 1095, xArm7 904, Panda 882, Kinova j2s6s200 815 kg/m^3. A single link may be wrong by a factor of two.
"""

import xml.etree.ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from service.errors import BadInput
from service.maker_urdf.finding import Finding
from service.maker_urdf.hulls import link_shapes, solid
from service.urdf import inertia_matrix, read_chain, read_inertial, transform_inertial

Array = NDArray[np.float64]

DENSITY = 1000.0  # kg/m^3
_TOLERANCE = 1e-3  # of the largest principal inertia: rounding by manufacturers


def complete_inertials(root: ET.Element, place: str) -> list[Finding]:
    """Add an `<inertial>` to each moving link whose mass, with all fixed children, is zero; returns the findings."""
    found: list[Finding] = []
    links = {link.get("name", ""): link for link in root.findall("link")}
    chain = read_chain(ET.tostring(root, encoding="unicode"), place)
    for joint, inertial in zip(chain.joints, chain.inertial, strict=True):
        if inertial[0] > 0:
            continue
        try:
            bodies = [solid(shape) for shape in link_shapes(links[joint.link], place)]
        except BadInput as error:
            found.append(Finding("missing", joint.link, f"has no <inertial>, and its shapes give none: {error.reason}"))
            continue
        if not bodies:
            found.append(Finding("missing", joint.link, "has neither <inertial> nor a shape to estimate one from"))
            continue
        mass = DENSITY * sum(volume for volume, _, _ in bodies)
        _write(links[joint.link], bodies, mass)
        found.append(
            Finding(
                "changed",
                joint.link,
                f"has no <inertial>: {mass:.3g} kg, from its shapes at {DENSITY:.0f} kg/m^3; a guess, and the prior of "
                "the side file is widened to 100 %",
            )
        )
    return found


def _write(link: ET.Element, bodies: list[tuple[float, Array, Array]], mass: float) -> None:
    """Replace the link's inertial by that of the bodies at the density."""
    centre = DENSITY * sum((volume * own for volume, own, _ in bodies), np.zeros(3)) / mass
    spread = DENSITY * sum((moment for _, _, moment in bodies), np.zeros((3, 3))) - mass * np.outer(centre, centre)
    tensor = np.trace(spread) * np.eye(3) - spread
    for element in link.findall("inertial"):
        link.remove(element)
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz=" ".join(f"{x:.6g}" for x in centre), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=f"{mass:.6g}")
    entries = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    ET.SubElement(inertial, "inertia", {key: f"{tensor[entry]:.9g}" for key, entry in entries.items()})


def look_at_inertials(root: ET.Element, place: str) -> list[Finding]:
    """Physically impossible values: negative mass, principal inertias that violate the triangle inequality."""
    found: list[Finding] = []
    for link in root.findall("link"):
        parameters = read_inertial(link, place)
        name, mass = link.get("name", ""), float(parameters[0])
        if mass < 0 or (mass == 0 and parameters.any()):
            found.append(Finding("unusual", name, f"has inertia and a mass of {mass:.4g} kg"))
        if mass <= 0:
            continue
        own = transform_inertial(parameters, np.eye(3), -parameters[1:4] / mass)
        principal = np.sort(np.linalg.eigvalsh(inertia_matrix(own)))
        if principal[0] < -_TOLERANCE * abs(principal[2]) or principal[2] > (1 + _TOLERANCE) * (
            principal[0] + principal[1]
        ):
            shown = ", ".join(f"{value:.3g}" for value in principal)
            found.append(Finding("unusual", name, f"no body has its principal inertias {shown} kg m^2"))
    return found
