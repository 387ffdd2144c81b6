"""Points of a COLLADA file (Khronos, "COLLADA Digital Asset Schema 1.4.1"): positions in the scene, in m.

The up direction in the file is ignored, as usual for the meshes of a URDF.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from service.model.errors import BadInput

Array = NDArray[np.float64]

DEEPEST = 100  # levels of nested nodes
MOST_NODES = 10_000  # in the scene: instances of instances can grow exponentially with depth
MOST_ELEMENTS = 500_000  # of the file
LONGEST = 2**24  # characters of one list of numbers
MOST_POINTS = 4_000_000  # in the scene


class _Bounded(ET.TreeBuilder):
    """Builder for the XML parser. ValueError for a DOCTYPE, whose entities may expand, and for too many elements."""

    _elements = 0

    def start(self, tag: str, attrs: dict[str, str], /) -> ET.Element:
        self._elements += 1
        if self._elements > MOST_ELEMENTS:
            raise ValueError(f"has more than {MOST_ELEMENTS} elements")
        return super().start(tag, attrs)

    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        raise ValueError("declares a DOCTYPE; entities are not expanded")


def collada_points(content: bytes, here: str) -> Array:
    """Points (n, 3) of all geometries in the scene, m; BadInput or ValueError if they cannot be read."""
    try:
        root = ET.fromstring(content, ET.XMLParser(target=_Bounded()))
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
    read: dict[int, Array] = {}  # by geometry: the scene may use one many times
    count = 0
    for transform, geometry in _instances(shown, np.eye(4), named, _Visits(here)):
        points = read.get(id(geometry))
        if points is None:
            points = read[id(geometry)] = _positions(geometry, named)
        count += len(points)
        if count > MOST_POINTS:
            raise BadInput(here, f"shows more than {MOST_POINTS} points")
        parts.append(points @ transform[:3, :3].T + transform[:3, 3])
    return metres * np.concatenate([np.empty((0, 3)), *parts])


class _Visits:
    """Counts nodes in the scene, including empty ones."""

    def __init__(self, here: str) -> None:
        self._here, self._count = here, 0

    def one_more(self, depth: int) -> None:
        """BadInput above the limits."""
        self._count += 1
        if depth > DEEPEST:
            raise BadInput(self._here, f"nodes are nested deeper than {DEEPEST}")
        if self._count > MOST_NODES:
            raise BadInput(self._here, f"shows more than {MOST_NODES} nodes and geometries")


def _instances(
    parent: ET.Element, transform: Array, named: dict[str, ET.Element], visits: _Visits, depth: int = 0
) -> Iterator[tuple[Array, ET.Element]]:
    """Every geometry below a node, with its pose (4, 4)."""
    visits.one_more(depth)
    for element in parent:
        target = named.get(element.get("url", ""))
        if element.tag == "node":
            yield from _instances(element, transform @ _transform(element), named, visits, depth + 1)
        elif element.tag == "instance_node" and target is not None:
            yield from _instances(target, transform @ _transform(target), named, visits, depth + 1)
        elif element.tag == "instance_geometry" and target is not None:
            visits.one_more(depth)
            yield transform, target


def _transform(node: ET.Element) -> Array:
    """The product of the node's transforms in their order, (4, 4)."""
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
    """Rotation about an axis (3,) by an angle in degrees."""
    x, y, z = numbers[:3] / max(float(np.linalg.norm(numbers[:3])), 1e-12)
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.deg2rad(numbers[3])
    return np.eye(3) + np.sin(angle) * skew + (1 - np.cos(angle)) * (skew @ skew)


def _positions(geometry: ET.Element, named: dict[str, ET.Element]) -> Array:
    """The positions (n, 3) of a geometry that its faces use, in its own unit."""
    meshes = geometry.findall("mesh/vertices")
    entries = [entry for vertices in meshes for entry in vertices.findall("input[@semantic='POSITION']")]
    if len(meshes) > 1 or len(entries) > 1:  # each would process all faces again
        raise ValueError(f"a geometry has {len(meshes)} <vertices> with {len(entries)} positions; one of each is read")
    source = named.get(entries[0].get("source", "")) if entries else None
    if source is None:
        return np.empty((0, 3))
    return _source(source)[_used(geometry, f"#{meshes[0].get('id')}")]


def _source(source: ET.Element) -> Array:
    numbers, accessor = source.find("float_array"), source.find("technique_common/accessor")
    if numbers is None:
        raise ValueError("positions without <float_array>")
    stride = 3 if accessor is None else int(accessor.get("stride", "3"))
    if stride < 3:
        raise ValueError(f"positions of {stride} numbers")
    return _numbers(numbers).reshape(-1, stride)[:, :3]


def _used(geometry: ET.Element, vertices: str) -> NDArray[np.int64]:
    """Indices of the positions used by the primitives of the mesh."""
    numbers: list[NDArray[np.int64]] = [np.empty(0, np.int64)]
    for primitive in geometry.iterfind("mesh/*"):
        inputs = primitive.findall("input")
        place = next((int(one.get("offset", "0")) for one in inputs if one.get("source") == vertices), None)
        if place is None:
            continue
        stride = 1 + max(int(one.get("offset", "0")) for one in inputs)
        for indices in primitive.iter("p"):
            words = np.array(_text(indices).split(), dtype=np.int64)
            numbers.append(words.reshape(-1, stride)[:, place])
    return np.unique(np.concatenate(numbers))


def _numbers(element: ET.Element) -> Array:
    return np.array([float(number) for number in _text(element).split()])


def _text(element: ET.Element) -> str:
    """ValueError if the list of numbers is too long."""
    text = element.text or ""
    if len(text) > LONGEST:
        raise ValueError(f"<{element.tag}> has {len(text)} characters, limit {LONGEST}")
    return text
