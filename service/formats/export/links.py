"""The links of a URDF, each with its pose in the moving link to which it is fixed."""

import xml.etree.ElementTree as ET
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.model.urdf import read_origin

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PlacedLink:
    """A ``<link>``, the moving link that carries it (itself, if it moves; None: the base), and its pose in that."""

    element: ET.Element
    carrier: str | None
    rotation: Array  # (3, 3)
    translation: Array  # (3,)

    @property
    def name(self) -> str:
        return self.element.get("name", "")


def placed_links(root: ET.Element) -> list[PlacedLink]:
    """All links, base to tip. The structure is valid, because the URDF's chain was read before."""
    links = {element.get("name", ""): element for element in root.findall("link")}
    children: dict[str, list[ET.Element]] = {}
    for joint in root.findall("joint"):
        children.setdefault(_link(joint, "parent"), []).append(joint)
    carried = {_link(joint, "child") for joint in root.findall("joint")}
    found = [PlacedLink(links[name], None, np.eye(3), np.zeros(3)) for name in links if name not in carried]
    for placed in found:  # extended during the loop
        for joint in children.get(placed.name, []):
            child = links[_link(joint, "child")]
            if joint.get("type") != "fixed":
                found.append(PlacedLink(child, child.get("name", ""), np.eye(3), np.zeros(3)))
                continue
            rotation, translation = read_origin(joint, f"urdf joint {joint.get('name')}")
            place = placed.rotation @ rotation, placed.translation + placed.rotation @ translation
            found.append(PlacedLink(child, placed.carrier, *place))
    return found


def _link(joint: ET.Element, tag: str) -> str:
    element = joint.find(tag)
    return "" if element is None else element.get("link", "")
