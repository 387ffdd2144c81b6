"""The simple collision shapes of a URDF, in the frames of the moving links that carry them."""

import xml.etree.ElementTree as ET
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.formats.export.links import placed_links
from service.model.errors import BadInput
from service.model.urdf import read_origin

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Shape:
    """A box (half sizes), cylinder (radius, half length) or sphere (radius), m, with its pose in the moving link."""

    kind: str
    size: tuple[float, ...]
    rotation: Array  # (3, 3)
    translation: Array  # (3,)


def shapes(urdf_text: str) -> dict[str | None, list[Shape]]:
    """Shapes by moving link, None: the base. BadInput if the numbers of a shape cannot be read."""
    found: dict[str | None, list[Shape]] = {}
    for link in placed_links(ET.fromstring(urdf_text)):
        here = f"urdf link {link.name} collision"
        for collision in link.element.findall("collision"):
            rotation, translation = read_origin(collision, here)
            try:
                kind, size = _geometry(collision)
            except ValueError as error:
                raise BadInput(here, f"cannot be read: {error}") from None
            if kind:
                place = link.rotation @ rotation, link.translation + link.rotation @ translation
                found.setdefault(link.carrier, []).append(Shape(kind, size, *place))
    return found


def _geometry(collision: ET.Element) -> tuple[str, tuple[float, ...]]:
    """Kind and size; both empty for other shapes, for example a mesh."""
    box, cylinder, sphere = (collision.find(f"geometry/{kind}") for kind in ("box", "cylinder", "sphere"))
    if box is not None:
        x, y, z = (float(side) / 2 for side in box.get("size", "").split())
        return "box", (x, y, z)
    if cylinder is not None:
        return "cylinder", (float(cylinder.get("radius", "")), float(cylinder.get("length", "")) / 2)
    if sphere is not None:
        return "sphere", (float(sphere.get("radius", "")),)
    return "", ()
