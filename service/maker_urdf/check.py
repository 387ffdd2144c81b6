"""Unusual and missing data of a manufacturer's URDF, and the URDF with which the service can plan."""

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.errors import BadInput
from service.maker_urdf.chain import choose_chain
from service.maker_urdf.finding import Finding
from service.maker_urdf.hulls import embed_hulls, link_shapes
from service.maker_urdf.inertials import complete_inertials, look_at_inertials
from service.maker_urdf.packages import Packages
from service.urdf import MOST_LINKS, Chain, Joint, look_over, read_chain

Array = NDArray[np.float64]

LONGEST_SHAPE, SHORTEST_SHAPE = 5.0, 0.002  # m: outside, a mesh is probably in mm, or scaled twice
FASTEST = {"revolute": 20.0, "prismatic": 10.0}  # rad/s, m/s
STRONGEST = 1e5  # N m, N


@dataclass(frozen=True)
class UrdfCheck:
    """`urdf_text`: one serial chain with all data for planning. `guessed`: links with an estimated inertial."""

    name: str
    urdf_text: str
    chain: Chain
    findings: tuple[Finding, ...]
    gear_ratios: Mapping[str, float | None]  # by joint, of its <transmission>
    guessed: tuple[str, ...]
    unread: tuple[BadInput, ...]  # meshes missing in `urdf_text`


def check_urdf(text: str, packages: Packages, tip: str | None, place: str) -> UrdfCheck:
    """Check a URDF and extract the chain to `tip` (None: its only one). BadInput if there is no such chain."""
    look_over(text, place)
    root = ET.fromstring(text)
    if root.tag != "robot":
        raise BadInput(place, f"is not a URDF: begins with <{root.tag}>, not <robot>; expand a xacro file first")
    for tag in ("link", "joint"):
        if len(root.findall(tag)) > MOST_LINKS:
            raise BadInput(place, f"has {len(root.findall(tag))} {tag}s, limit {MOST_LINKS}")
    found = choose_chain(root, tip, place)
    offs, unread = embed_hulls(root, packages, place)
    found += [Finding("missing", error.place.removeprefix(place).strip(), error.reason) for error in unread]
    if offs:
        worst = max(offs, key=lambda name: offs[name])
        larger = f"The hull of this one is larger than its mesh by up to {1e3 * offs[worst]:.1f} mm, the most of all"
        found.append(Finding("changed", worst, f"{len(offs)} collision meshes are used as convex hulls. {larger}"))
    guessed = complete_inertials(root, place)
    chain = read_chain(ET.tostring(root, encoding="unicode"), place)
    found += [*guessed, *look_at_inertials(root, place), *_shapes(root, chain, place)]
    for joint in chain.joints:
        found += _limits(joint)
    ratios = {joint.name: _gear_ratio(root, joint.name, place) for joint in chain.joints}
    found += [*_drive_data(chain, ratios), *_dampings(root, chain, place)]
    return UrdfCheck(
        name=root.get("name") or "robot",
        urdf_text=ET.tostring(root, encoding="unicode") + "\n",
        chain=chain,
        findings=tuple(found),
        gear_ratios=ratios,
        guessed=tuple(finding.place for finding in guessed if finding.kind == "changed"),
        unread=tuple(unread),
    )


def _shapes(root: ET.Element, chain: Chain, place: str) -> list[Finding]:
    reported: list[Finding] = []
    moving = {joint.link for joint in chain.joints}
    for link in root.findall("link"):
        name = link.get("name", "")
        try:
            shapes = list(link_shapes(link, place))
        except BadInput as error:
            if link.find("collision/geometry/mesh") is None:
                raise
            del error  # a missing mesh was reported before
            continue
        if not shapes and name in moving:
            reported.append(
                Finding("unusual", name, "moves but has no collision shape: its collisions are not detected")
            )
        for shape in shapes:
            size = float(np.ptp(shape, axis=0).max())
            if not SHORTEST_SHAPE <= size <= LONGEST_SHAPE:
                reported.append(
                    Finding("unusual", name, f"has a collision shape of {size:.3g} m: is its unit the metre?")
                )
    return reported


def _limits(joint: Joint) -> list[Finding]:
    unit = "m" if joint.kind == "prismatic" else "rad"
    effort = "N" if joint.kind == "prismatic" else "N m"
    reported: list[Finding] = []
    if joint.soft:
        limits = f"{joint.lower:g} to {joint.upper:g} {unit}"
        what = "the soft limits of <safety_controller> are narrower than <limit> and are used"
        reported.append(Finding("unusual", joint.name, f"position limits {limits}: {what}"))
    for name, value, most, of in (
        ("velocity", joint.velocity, FASTEST[joint.kind], f"{unit}/s"),
        ("effort", joint.effort, STRONGEST, effort),
    ):
        if not np.isfinite(value) or value <= 0:
            reported.append(Finding("missing", joint.name, f"{name} limit: {value:g} {of} is not a usable limit"))
        elif value > most:
            reported.append(Finding("unusual", joint.name, f"{name} limit {value:g} {of} is not plausible"))
    return reported


def _gear_ratio(root: ET.Element, joint: str, place: str) -> float | None:
    """The reduction of the joint's `<transmission>`; None if there is none, or if it is 1 (used by simulators)."""
    reductions = {
        _number(reduction.text, f"{place} transmission mechanicalReduction")
        for transmission in root.findall("transmission")
        if any(own.get("name") == joint for own in transmission.findall("joint"))
        for reduction in transmission.iter("mechanicalReduction")
    }
    return reductions.pop() if len(reductions) == 1 and not reductions & {0.0, 1.0} else None


def _drive_data(chain: Chain, ratios: Mapping[str, float | None]) -> list[Finding]:
    """Data that a URDF cannot contain: the user must complete the side file."""
    joints = [joint.name for joint in chain.joints]
    bare = [joint for joint in joints if ratios[joint] is None]
    reported = [Finding("missing", ", ".join(bare), "gear ratio")] if bare else []
    reported.append(Finding("missing", ", ".join(joints), "rated effort: a URDF has only the limit"))
    reported.append(
        Finding("missing", ", ".join(joints), "motor inertia; left open it is found with the load, less well")
    )
    reported.append(
        Finding(
            "missing",
            ", ".join(joints),
            "cogging orders (torque ripple, periods per motor turn); without them J can be ten times less certain",
        )
    )
    return reported


def _dampings(root: ET.Element, chain: Chain, place: str) -> list[Finding]:
    """Manufacturers set damping for simulators: a wrong value, as a prior of friction, would cause a wrong J."""
    moving = {joint.name for joint in chain.joints}
    dampings = {
        joint.get("name", ""): _number(dynamics.get("damping"), f"{place} joint {joint.get('name')} damping")
        for joint in root.findall("joint")
        if joint.get("name") in moving
        for dynamics in joint.findall("dynamics")
    }
    shown = ", ".join(f"{joint} {damping:g}" for joint, damping in dampings.items() if damping)
    return (
        [Finding("unusual", shown, "damping is not used as friction: it is mostly a value for simulators")]
        if shown
        else []
    )


def _number(text: str | None, place: str) -> float:
    try:
        value = float(text or "0")
    except ValueError:
        raise BadInput(place, f"{text!r} is not a number") from None
    if not math.isfinite(value):
        raise BadInput(place, f"{text!r} is not finite")
    return value
