r"""Reads a URDF into a serial chain: joint frames, limits and the links' ten inertial parameters.

Shapes, transmissions and visuals are ignored. Source: the URDF XML specification (ROS wiki, "urdf/XML");
rpy are fixed-axis angles, R = Rz(yaw) Ry(pitch) Rx(roll).

Convex hulls inside a URDF: `<mesh filename="..."><hull vertices="x y z ..."/></mesh>`.

A URDF contains names of mesh files, not the meshes. `sweepid robot check`, run where the files are, writes the hulls of
the collision meshes into it. Then only the text is needed: in the store, in a bundle, in another process.
Vertices are in m in the frame of the shape's `<origin>`, with the mesh's scale applied. Other URDF readers ignore it.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal
from xml.parsers import expat

import numpy as np

from service import BadInput
from service.model.arrays import Array

MOST_LINKS = 200  # a serial robot has about ten; the chain is read recursively
MOST_ELEMENTS = 20_000
DEEPEST = 50  # levels of nested elements; URDF has about six
LARGEST = 1e15  # of a number, SI; its square does not overflow
_CHOOSE = "only a serial chain can be measured, `sweepid robot check URDF --tip LINK` makes one of it"


@dataclass(frozen=True)
class Joint:
    """One moving joint and the link it carries (fixed children included)."""

    name: str
    kind: Literal["revolute", "prismatic"]
    link: str
    rotation: Array  # (3, 3) of this frame in the previous moving link's frame at q = 0
    translation: Array  # (3,) m
    axis: Array  # (3,) unit vector in this frame
    lower: float  # rad (m); -inf for a continuous joint
    upper: float
    velocity: float  # rad/s (m/s)
    effort: float  # N m (N)
    soft: bool = False  # a position limit is that of `<safety_controller>`, which is narrower


@dataclass(frozen=True)
class Chain:
    """Moving joints from base to tip, with the nominal inertial parameters of their links, (n, 10)."""

    joints: tuple[Joint, ...]
    inertial: Array


def read_chain(text: str, place: str = "urdf") -> Chain:
    """The serial chain of a URDF; BadInput if it branches, has loops or lacks a number."""
    look_over(text, place)
    root = ET.fromstring(text)
    links = {element.get("name", ""): element for element in root.findall("link")}
    joints = root.findall("joint")
    for what, count in (("links", len(links)), ("joints", len(joints))):
        if count > MOST_LINKS:
            raise BadInput(place, f"has {count} {what}, limit {MOST_LINKS}")
    children: dict[str, list[ET.Element]] = {}
    for element in joints:
        children.setdefault(joint_end(element, "parent", place), []).append(element)
    _once([element.get("name", "") for element in root.findall("link")], place, "link {!r} occurs twice")
    _once([element.get("name", "") for element in joints], place, "joint {!r} occurs twice")
    carried = [joint_end(element, "child", place) for element in joints]
    _once(carried, place, "link {!r} is the child of two joints")
    roots = [name for name in links if name not in carried]
    if len(roots) != 1:
        raise BadInput(place, f"needs one base link, has {len(roots)}: {roots}; {_CHOOSE}")

    chain: list[Joint] = []
    inertial: list[Array] = []

    def walk(link: str, body: int, rotation: Array, translation: Array) -> None:
        # rotation, translation: of `link` in the frame of moving link number `body`; -1: the base
        if link not in links:
            raise BadInput(place, f"link {link!r} of a joint is not defined")
        if body >= 0:
            own = read_inertial(links[link], place)
            inertial[body] = inertial[body] + transform_inertial(own, rotation, translation)
        moving_children = 0
        for element in children.get(link, []):
            turned, moved = read_origin(element, f"{place} joint {element.get('name')}")
            joint_rotation, joint_translation = rotation @ turned, translation + rotation @ moved
            child = joint_end(element, "child", place)
            if element.get("type") == "fixed":
                walk(child, body, joint_rotation, joint_translation)
                continue
            moving_children += 1
            if moving_children > 1:
                names = [one.get("name") for one in children[link] if one.get("type") != "fixed"]
                raise BadInput(place, f"link {link!r} is the parent of two or more moving joints, {names}; {_CHOOSE}")
            chain.append(_joint(element, child, joint_rotation, joint_translation, place))
            inertial.append(np.zeros(10))
            walk(child, len(inertial) - 1, np.eye(3), np.zeros(3))

    walk(roots[0], -1, np.eye(3), np.zeros(3))
    if not chain:
        raise BadInput(place, "has no moving joint")
    return Chain(tuple(chain), np.array(inertial))


def look_over(text: str, place: str) -> None:
    """Check before parsing: BadInput for a text that is no XML, has a DOCTYPE, or is larger than any robot."""
    longest_name = 200
    depth, count = 0, 0

    def begin(kind: str, attributes: Mapping[str, str]) -> None:
        nonlocal depth, count
        depth, count = depth + 1, count + 1
        if depth > DEEPEST or count > MOST_ELEMENTS:
            raise BadInput(place, f"has more than {MOST_ELEMENTS} elements, or is nested deeper than {DEEPEST}")
        name = attributes.get("name", "")
        if kind in ("link", "joint") and (len(name) > longest_name or not name.isprintable()):
            raise BadInput(place, f"name {name[:20]!r} of a {kind} is longer than {longest_name} or not printable")

    def end(_: str) -> None:
        nonlocal depth
        depth -= 1

    def doctype(*_: object) -> None:
        raise BadInput(place, "declares a DOCTYPE; entities are not expanded")

    parser = expat.ParserCreate(namespace_separator="}")  # as in ElementTree: prefixes must be bound
    parser.StartDoctypeDeclHandler = doctype
    parser.StartElementHandler = begin
    parser.EndElementHandler = end
    try:
        parser.Parse(text, True)
    except (expat.ExpatError, ValueError) as error:
        raise BadInput(place, f"not XML: {error}") from None


def transform_inertial(parameters: Array, rotation: Array, translation: Array) -> Array:
    """Ten parameters of a body given in frame B, expressed in frame A, where (R, t) is the pose of B in A."""
    mass, moment, inertia = parameters[0], parameters[1:4], inertia_matrix(parameters)
    moved = rotation @ moment
    cross = moved @ translation
    # Huygens-Steiner for a frame that is not at the centre of mass, c' = R mc:
    # I_A = R I R' + 2 (c'.t) 1 - (c' t^T + t c'^T) + m (t.t 1 - t t^T)
    shifted = (
        rotation @ inertia @ rotation.T
        + 2 * cross * np.eye(3)
        - np.outer(moved, translation)
        - np.outer(translation, moved)
        + mass * (translation @ translation * np.eye(3) - np.outer(translation, translation))
    )
    return np.concatenate([[mass], moved + mass * translation, inertia_vector(shifted)])


def inertia_matrix(parameters: Array) -> Array:
    """(..., 10) parameters -> inertia (..., 3, 3) at the frame's origin."""
    xx, xy, yy, xz, yz, zz = np.moveaxis(parameters[..., 4:10], -1, 0)
    return np.stack([np.stack(row, -1) for row in ([xx, xy, xz], [xy, yy, yz], [xz, yz, zz])], -2)


def inertia_vector(matrix: Array) -> Array:
    """Inertia (3, 3) -> [Ixx, Ixy, Iyy, Ixz, Iyz, Izz]."""
    return matrix[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]


def rotation_rpy(rpy: Array) -> Array:
    """Rz(yaw) Ry(pitch) Rx(roll), (3, 3)."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def _joint(element: ET.Element, link: str, rotation: Array, translation: Array, place: str) -> Joint:
    name = element.get("name", "")
    here = f"{place} joint {name}"
    kind = element.get("type")
    if kind not in ("revolute", "continuous", "prismatic"):
        raise BadInput(here, f"type {kind!r} is not supported; use revolute, continuous, prismatic or fixed")
    mimic = element.find("mimic")
    if mimic is not None:
        raise BadInput(here, f"follows joint {mimic.get('joint')!r} (<mimic>) and has no drive of its own; {_CHOOSE}")
    axis = read_axis(element, here)
    limit = element.find("limit")
    if limit is None and kind != "continuous":
        raise BadInput(here, "has no <limit>")
    hard = lower, upper = -np.inf, np.inf
    if kind != "continuous":
        hard = _limit(limit, "lower", here), _limit(limit, "upper", here)
        lower, upper = _soft_limits(element, hard, here)
    if lower >= upper:
        raise BadInput(here, f"lower limit {lower} is not below upper limit {upper}")
    return Joint(
        name=name,
        kind="prismatic" if kind == "prismatic" else "revolute",
        link=link,
        rotation=rotation,
        translation=translation,
        axis=axis,
        lower=lower,
        upper=upper,
        velocity=_limit(limit, "velocity", here),
        effort=_limit(limit, "effort", here),
        soft=(lower, upper) != hard,
    )


def _soft_limits(joint: ET.Element, hard: tuple[float, float], here: str) -> tuple[float, float]:
    """The narrower of the limits and those of `<safety_controller>`, whose own controller does not run here.

    A limit that it does not state is not one; the specification's default of 0 would leave no travel.
    """
    safety = joint.find("safety_controller")
    low, high = (
        None if safety is None or safety.get(name) is None else _number(safety, name, here)
        for name in ("soft_lower_limit", "soft_upper_limit")
    )
    return hard[0] if low is None else max(hard[0], low), hard[1] if high is None else min(hard[1], high)


def read_inertial(link: ET.Element, place: str) -> Array:
    """Ten parameters of a ``<link>`` at its frame's origin, zeros if it has none; BadInput if they are no numbers."""
    element = link.find("inertial")
    if element is None:
        return np.zeros(10)
    here = f"{place} link {link.get('name')}"
    mass_element, inertia_element = element.find("mass"), element.find("inertia")
    if mass_element is None or inertia_element is None:
        raise BadInput(here, "<inertial> needs <mass> and <inertia>")
    mass = _number(mass_element, "value", here)
    tensor = [_number(inertia_element, name, here) for name in ("ixx", "ixy", "iyy", "ixz", "iyz", "izz")]
    rotation, translation = read_origin(element, here)
    return transform_inertial(np.array([mass, 0.0, 0.0, 0.0, *tensor]), rotation, translation)


def read_origin(element: ET.Element, here: str) -> tuple[Array, Array]:
    """Rotation (3, 3) and translation (3,) of the ``<origin>`` in an element; BadInput if they are no numbers."""
    origin = element.find("origin")
    if origin is None:
        return np.eye(3), np.zeros(3)
    return rotation_rpy(_vector(origin, "rpy", here)), _vector(origin, "xyz", here)


def read_axis(joint: ET.Element, here: str) -> Array:
    """Unit vector (3,) of a joint's ``<axis>`` in its frame; BadInput if it has no direction."""
    element = joint.find("axis")
    axis = np.array([1.0, 0.0, 0.0]) if element is None else _vector(element, "xyz", here)
    norm = float(np.linalg.norm(axis))
    if norm < 1e-9:
        raise BadInput(here, "axis has no direction")
    return axis / norm


def joint_end(joint: ET.Element, tag: Literal["parent", "child"], place: str) -> str:
    """The link at one end of a joint; BadInput if it is not stated."""
    end = joint.find(tag)
    name = None if end is None else end.get("link")
    if name is None:
        raise BadInput(f"{place} joint {joint.get('name')}", f"has no <{tag} link=...>")
    return name


def inertia_at_centre(parameters: Array) -> Array:
    """Ten parameters of a body -> inertia (3, 3) about its centre of mass; the mass is not 0."""
    return inertia_matrix(transform_inertial(parameters, np.eye(3), -parameters[1:4] / parameters[0]))


def _once(names: list[str], place: str, complaint: str) -> None:
    for name in names:
        if names.count(name) > 1:
            raise BadInput(place, complaint.format(name))


def _limit(element: ET.Element | None, name: str, here: str) -> float:
    if element is None:
        return float("inf")
    if name in ("lower", "upper") and element.get(name) is None:
        return 0.0  # the specification's default
    return _number(element, name, here)


def _number(element: ET.Element, name: str, here: str) -> float:
    text = element.get(name)
    try:
        value = float(text or "")
    except ValueError:
        raise BadInput(here, f"{element.tag} {name}={text!r} is not a number") from None
    if not abs(value) <= LARGEST:
        raise BadInput(here, f"{element.tag} {name}={text!r} is not finite or beyond {LARGEST:g}")
    return value


def _vector(element: ET.Element, name: str, here: str) -> Array:
    text = element.get(name, "0 0 0")
    try:
        values = np.array([float(part) for part in text.split()])
    except ValueError:
        raise BadInput(here, f"{element.tag} {name}={text!r} is not three numbers") from None
    if values.shape != (3,) or not (np.abs(values) <= LARGEST).all():
        raise BadInput(here, f"{element.tag} {name}={text!r} is not three finite numbers up to {LARGEST:g}")
    return values


def collision_meshes(root: ET.Element) -> Iterator[tuple[str, ET.Element]]:
    """Every `<mesh>` of a collision shape, with the name of its link."""
    for link in root.findall("link"):
        for mesh in link.iterfind("collision/geometry/mesh"):
            yield link.get("name", ""), mesh


def write_hull(mesh: ET.Element, vertices: Array) -> None:
    """Give a mesh its hull (k, 3)."""
    ET.SubElement(mesh, "hull", vertices=" ".join(f"{number:.6g}" for number in vertices.ravel()))


def read_hull(mesh: ET.Element, here: str) -> Array:
    """The hull (k, 3) of a mesh; BadInput if the mesh has none or it is not a valid body."""
    farthest = 1e4  # m, of a coordinate
    most_numbers = 30_000  # of one hull
    name, element = mesh.get("filename", ""), mesh.find("hull")
    if element is None:
        raise BadInput(
            here, f"mesh {name}: its shape is not in the URDF; `sweepid robot check URDF --packages DIR` puts it in"
        )
    words = element.get("vertices", "").split(maxsplit=most_numbers)
    if len(words) > most_numbers:
        raise BadInput(here, f"mesh {name}: its hull has more than {most_numbers} numbers")
    try:
        numbers = np.array([float(word) for word in words])
    except ValueError as error:
        raise BadInput(here, f"mesh {name}: hull: {error}") from None
    if len(numbers) % 3 or not np.isfinite(numbers).all():
        raise BadInput(here, f"mesh {name}: its hull is not finite numbers in threes")
    if np.abs(numbers).max(initial=0.0) > farthest:
        raise BadInput(here, f"mesh {name}: its hull reaches {np.abs(numbers).max():.3g} m, limit {farthest:g} m")
    vertices = numbers.reshape(-1, 3)
    if len(vertices) < 4 or np.linalg.matrix_rank(vertices - vertices[:1], tol=1e-9) < 3:
        raise BadInput(here, f"mesh {name}: its hull is not a body: {len(vertices)} points, or all in one plane")
    return vertices
