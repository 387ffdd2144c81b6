"""Points of a COLLADA file (Khronos, "COLLADA Digital Asset Schema 1.4.1"): positions as the scene places them, in m.

The direction that the file calls up is left alone, as robots' makers expect of a URDF's meshes.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from service.errors import BadInput

Array = NDArray[np.float64]

DEEPEST, MOST_INSTANCES = 100, 10_000


def collada_points(content: bytes, here: str) -> Array:
    """Points (n, 3) of all geometries that the scene shows, m; BadInput or ValueError if they cannot be read."""
    try:
        root = ET.fromstring(content)
    except ET.ParseError as error:
        raise BadInput(here, f"not XML: {error}") from None
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    named = {f"#{name}": element for element in root.iter() if (name := element.get("id")) is not None}
    unit = root.find("asset/unit")
    metres = 1.0 if unit is None else float(unit.get("meter", "1"))
    scene = root.find("scene/instance_visual_scene")
    shown = None if scene is None else named.get(scene.get("url", ""))
    if shown is None:
        shown = root.find("library_visual_scenes/visual_scene")
    if shown is None:
        raise BadInput(here, "has no visual scene")
    parts: list[Array] = []
    for transform, geometry in _instances(shown, np.eye(4), named, here):
        points = _positions(geometry, named)
        parts.append(points @ transform[:3, :3].T + transform[:3, 3])
        if len(parts) > MOST_INSTANCES:
            raise BadInput(here, f"shows more than {MOST_INSTANCES} geometries")
    return metres * np.concatenate([np.empty((0, 3)), *parts])


def _instances(
    parent: ET.Element, transform: Array, named: dict[str, ET.Element], here: str, depth: int = 0
) -> Iterator[tuple[Array, ET.Element]]:
    """Every geometry below a node, with the pose (4, 4) in which it stands."""
    if depth > DEEPEST:
        raise BadInput(here, f"nodes are nested deeper than {DEEPEST}")
    for element in parent:
        target = named.get(element.get("url", ""))
        if element.tag == "node":
            yield from _instances(element, transform @ _transform(element), named, here, depth + 1)
        elif element.tag == "instance_node" and target is not None:
            yield from _instances(target, transform @ _transform(target), named, here, depth + 1)
        elif element.tag == "instance_geometry" and target is not None:
            yield transform, target


def _transform(node: ET.Element) -> Array:
    """The node's transforms in the order in which they stand, (4, 4)."""
    whole = np.eye(4)
    for element in node:
        own = np.eye(4)
        if element.tag == "matrix":
            own = _numbers(element).reshape(4, 4)
        elif element.tag == "translate":
            own[:3, 3] = _numbers(element)
        elif element.tag == "scale":
            own[:3, :3] = np.diag(_numbers(element))
        elif element.tag == "rotate":
            own[:3, :3] = _rotation(_numbers(element))
        elif element.tag in ("lookat", "skew"):
            raise ValueError(f"<{element.tag}> is not supported")
        whole = whole @ own
    return whole


def _rotation(numbers: Array) -> Array:
    """About an axis (3,) by an angle in degrees."""
    x, y, z = numbers[:3] / max(float(np.linalg.norm(numbers[:3])), 1e-12)
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.deg2rad(numbers[3])
    return np.eye(3) + np.sin(angle) * skew + (1 - np.cos(angle)) * (skew @ skew)


def _positions(geometry: ET.Element, named: dict[str, ET.Element]) -> Array:
    """Those of a geometry's positions (n, 3) that its faces use, in its own unit."""
    parts = [np.empty((0, 3))]
    for vertices in geometry.iterfind("mesh/vertices"):
        for entry in vertices.iterfind("input[@semantic='POSITION']"):
            source = named.get(entry.get("source", ""))
            if source is not None:
                parts.append(_source(source)[_used(geometry, f"#{vertices.get('id')}")])
    return np.concatenate(parts)


def _source(source: ET.Element) -> Array:
    numbers, accessor = source.find("float_array"), source.find("technique_common/accessor")
    if numbers is None:
        raise ValueError("positions without <float_array>")
    stride = 3 if accessor is None else int(accessor.get("stride", "3"))
    if stride < 3:
        raise ValueError(f"positions of {stride} numbers")
    return _numbers(numbers).reshape(-1, stride)[:, :3]


def _used(geometry: ET.Element, vertices: str) -> NDArray[np.int64]:
    """Numbers of the positions that some primitive of the mesh refers to."""
    numbers: list[NDArray[np.int64]] = [np.empty(0, np.int64)]
    for primitive in geometry.iterfind("mesh/*"):
        inputs = primitive.findall("input")
        place = next((int(one.get("offset", "0")) for one in inputs if one.get("source") == vertices), None)
        if place is None:
            continue
        stride = 1 + max(int(one.get("offset", "0")) for one in inputs)
        for indices in primitive.iter("p"):
            words = np.array((indices.text or "").split(), dtype=np.int64)
            numbers.append(words.reshape(-1, stride)[:, place])
    return np.unique(np.concatenate(numbers))


def _numbers(element: ET.Element) -> Array:
    return np.array([float(number) for number in (element.text or "").split()])
