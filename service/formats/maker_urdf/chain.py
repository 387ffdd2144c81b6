"""One serial chain of a URDF that may have several: joints that are not between base and tip are fixed."""

import math
import warnings
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from service import BadInput
from service.model import joint_end, rotation_about
from service.model.urdf import read_axis, read_inertial, read_origin

MOVING = ("revolute", "continuous", "prismatic")


@dataclass(frozen=True)
class UrdfFinding:
    """`missing`: the user must complete it; `changed`: modified here; `unusual`: the user should check it."""

    kind: Literal["missing", "changed", "unusual"]
    place: str  # link, joint or file
    sentence: str


def choose_chain(root: ET.Element, tip: str | None, place: str) -> list[UrdfFinding]:
    """Make `root` one serial chain that ends in link `tip`, in place; returns the changes.

    None: the only chain. BadInput names the possible tips, or the reason why there is no such chain.
    """
    tree = _Tree(root, place)
    if tip is None:
        tip = tree.only_tip()
    way = tree.way_to(tip)
    done = tree.drop_other_trees(tip)
    moving = [joint for joint in way if joint.get("type") != "fixed"]
    for joint in moving:
        _check_moving(joint, place)
    done += _linkages(root, [joint.get("name", "") for joint in moving], place)
    for joint in root.findall("joint"):
        if joint.get("type") != "fixed" and joint not in moving:
            done.append(_fix(joint, place))
    return [*done, *(_with_ends(joint) for joint in moving if joint.get("type") == "continuous")]


class _Tree:
    """The links of a URDF, with their parents and children."""

    def __init__(self, root: ET.Element, place: str) -> None:
        self._root, self._place = root, place
        self._links = [link.get("name", "") for link in root.findall("link")]
        self._carrier: dict[str, ET.Element] = {}
        for joint in root.findall("joint"):
            child = joint_end(joint, "child", place)
            if child in self._carrier:
                both = f"{self._carrier[child].get('name')} and {joint.get('name')}"
                told = f"link {child!r} is the child of two joints, {both}"
                why = "a closed chain (parallel linkage) is not a serial chain, and sweepid cannot measure its axes"
                raise BadInput(place, f"{told}: {why}")
            self._carrier[child] = joint
            for link in (child, joint_end(joint, "parent", place)):
                if link not in self._links:
                    raise BadInput(place, f"link {link!r} of joint {joint.get('name')!r} is not defined")

    def way_to(self, link: str) -> list[ET.Element]:
        """Joints from the root of its tree to a link."""
        if link not in self._links:
            raise BadInput("--tip", f"{link!r} is not a link of {self._place}: {', '.join(self._links)}")
        way: list[ET.Element] = []
        while link in self._carrier:
            way.append(self._carrier[link])
            link = joint_end(way[-1], "parent", self._place)
            if len(way) > len(self._links):
                raise BadInput(self._place, f"link {link!r} is its own ancestor")
        return way[::-1]

    def only_tip(self) -> str:
        """The link carried by the last moving joint of the only chain; BadInput lists the tips if there are several."""
        ways = {link: self._moving(link) for link in self._links}
        inner = {id(joint) for way in ways.values() for joint in way[:-1]}
        ends = {
            link: way
            for link, way in ways.items()
            if way and way[-1] is self._carrier[link] and id(way[-1]) not in inner
        }
        if not ends:
            raise BadInput(self._place, "has no moving joint")
        if len(ends) == 1:
            return next(iter(ends))
        forks = {link: self._forked(link, list(ends.values())) for link in ends}
        shown = {**{link: self._moving(link) for link in forks.values()}, **ends}
        tips = ", ".join(f"{link} ({len(way)} axes)" for link, way in shown.items() if way)
        raise BadInput(self._place, f"has {len(ends)} chains; choose the end of one by --tip: {tips}")

    def drop_other_trees(self, tip: str) -> list[UrdfFinding]:
        """Remove links that belong to another root than the tip."""
        base = self._base(tip)
        others = {link for link in self._links if self._base(link) != base}
        for joint in self._root.findall("joint"):
            if joint_end(joint, "child", self._place) in others:
                self._root.remove(joint)
        for link in self._root.findall("link"):
            if link.get("name") in others:
                self._root.remove(link)
        roots = sorted(link for link in others if link not in self._carrier)
        return [
            UrdfFinding("changed", link, "is the base of another tree: left out with all its links") for link in roots
        ]

    def _moving(self, link: str) -> list[ET.Element]:
        return [joint for joint in self.way_to(link) if joint.get("type") != "fixed"]

    def _base(self, link: str) -> str:
        way = self.way_to(link)
        return joint_end(way[0], "parent", self._place) if way else link

    def _forked(self, link: str, ways: list[list[ET.Element]]) -> str:
        """The link after which the path to `link` and another path separate."""
        way = self._moving(link)
        shared = max(_shared(way, other) for other in ways if other is not way and other[-1] is not way[-1])
        return joint_end(way[shared], "parent", self._place)


def _shared(one: list[ET.Element], other: list[ET.Element]) -> int:
    return next((k for k, (a, b) in enumerate(zip(one, other, strict=False)) if a is not b), min(len(one), len(other)))


def _check_moving(joint: ET.Element, place: str) -> None:
    here, mimic = f"{place} joint {joint.get('name')}", joint.find("mimic")
    if joint.get("type") not in MOVING:
        raise BadInput(
            here, f"type {joint.get('type')!r} is not supported between base and tip; supported are {', '.join(MOVING)}"
        )
    if mimic is not None:
        raise BadInput(
            here,
            f"follows joint {mimic.get('joint')!r} (<mimic>) and is between base and tip: a parallel linkage, whose "
            "axes sweepid cannot measure; choose a link before it by --tip",
        )


def _linkages(root: ET.Element, axes: list[str], place: str) -> list[UrdfFinding]:
    """Joints beside the chain that follow one of its axes: bars through which the motor of another axis acts."""
    joints = root.findall("joint")
    leaders = {
        joint.get("name", ""): mimic.get("joint", "") for joint in joints if (mimic := joint.find("mimic")) is not None
    }
    children: dict[str, list[str]] = {}
    for joint in joints:
        children.setdefault(joint_end(joint, "parent", place), []).append(joint_end(joint, "child", place))
    masses = {link.get("name", ""): float(read_inertial(link, place)[0]) for link in root.findall("link")}
    found: list[UrdfFinding] = []
    for joint in joints:
        name = leader = joint.get("name", "")
        for _ in leaders:
            leader = leaders.get(leader, leader)
        if name == leader or name in axes or leader not in axes:
            continue
        carried = [joint_end(joint, "child", place)]
        for link in carried:  # extended during the loop
            carried += children.get(link, ())
        mass, at = sum(masses.get(link, 0.0) for link in carried), axes.index(leader)
        found.append(
            UrdfFinding(
                "unusual",
                ", ".join(axes[at : at + 2]),
                f"part of a parallel linkage: {name} follows {leader} (<mimic>) beside the chain. sweepid cannot "
                f"measure these axes; {mass:.4g} kg of moving mass are treated as if fixed",
            )
        )
    return found


def _fix(joint: ET.Element, place: str) -> UrdfFinding:
    """Replace a moving joint by a fixed one, at 0 or the nearest position within its limits."""
    here, mimic = f"{place} joint {joint.get('name')}", joint.find("mimic")
    kind, limit = joint.get("type"), joint.find("limit")
    if kind not in MOVING:
        raise BadInput(here, f"type {kind!r} cannot be fixed; only {', '.join(MOVING)} can")
    position = 0.0
    if kind != "continuous" and limit is not None:
        try:
            position = min(max(0.0, float(limit.get("lower", "0"))), float(limit.get("upper", "0")))
        except ValueError as error:
            raise BadInput(here, f"limit: {error}") from None
    if position:
        _shift(joint, position, here)
    for tag in ("mimic", "limit", "axis", "dynamics", "safety_controller", "calibration"):
        for element in joint.findall(tag):
            joint.remove(element)
    joint.set("type", "fixed")
    why = "is not between base and tip" if mimic is None else f"follows {mimic.get('joint')} (<mimic>)"
    return UrdfFinding("changed", joint.get("name", ""), f"{why}: fixed at {position:.4g}")


def _shift(joint: ET.Element, position: float, here: str) -> None:
    """Include the position of a joint in its origin."""
    rotation, translation = read_origin(joint, here)
    axis = read_axis(joint, here)
    if joint.get("type") == "prismatic":
        translation = translation + rotation @ axis * position
    else:
        rotation = rotation @ rotation_about(axis, np.array(position))
    for element in joint.findall("origin"):
        joint.remove(element)
    # fixed-axis roll, pitch, yaw as in URDF
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # at a pitch of 90 degrees several triples are the same rotation
        rpy = Rotation.from_matrix(rotation).as_euler("xyz")
    ET.SubElement(joint, "origin", xyz=_text(translation), rpy=_text(rpy))


def _with_ends(joint: ET.Element) -> UrdfFinding:
    """A continuous joint is limited to one turn: because of cables, and because a plan needs limits."""
    found = joint.find("limit")
    limit = ET.SubElement(joint, "limit") if found is None else found
    joint.set("type", "revolute")
    limit.set("lower", f"{-math.pi:.6f}")
    limit.set("upper", f"{math.pi:.6f}")
    told = "turns without end (continuous): limited to half a turn either way"
    return UrdfFinding("changed", joint.get("name", ""), told)


def _text(vector: np.ndarray) -> str:
    return " ".join(f"{float(number):.12g}" for number in vector)
