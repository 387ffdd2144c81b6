"""Convex hulls for the meshes of a URDF, and its inertials: those that no body has, placeholders, and what is missing.

A hull may have more points than the mesh, and always contains all of it: every point is replaced by the eight corners
of the grid cell that contains it. The hull (`<mesh>` gets a child `<hull>`) is at most one cell diagonal larger.

Simulators run with any numbers, so manufacturers leave out what they do not need, or export grams and millimetres. Each
is a finding; a link without mass is estimated from its shapes.
"""

import xml.etree.ElementTree as ET
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from service import BadInput
from service.formats.maker_urdf.chain import UrdfFinding
from service.formats.maker_urdf.packages import Packages, mesh_points
from service.identification.model import gravity_rows
from service.model import Array, Chain, Most, joint_end, read_chain
from service.model.urdf import collision_meshes, inertia_at_centre, read_hull, read_inertial, read_origin, write_hull

POSES = 200  # random ones, to find shapes that overlap by construction, and loads
FINEST = 1e-4  # m, edge of the grid's cells
MOST_VERTICES = 250  # of a hull; with more, the cells are made larger
_CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
Bodies = Sequence[tuple[float, Array, Array]]  # as `solid`
_WIDER = "the prior of the side file is widened to 100 %"


def convex_hull(points: Array) -> tuple[Array, float]:
    """Vertices (k, 3) of a convex body that contains all points (n, 3), and its largest distance from them, m.

    ValueError for points farther than `MOST_LENGTH` from the origin.
    """
    if np.abs(points).max() > Most.length:
        raise ValueError(f"reaches {np.abs(points).max():.3g} m from its origin")
    with suppress(QhullError):  # flat: the cells give it a thickness
        points = points[ConvexHull(points).vertices]
    cell = FINEST
    while True:
        cells = np.unique(np.floor(points / cell), axis=0)
        if len(cells) <= 20_000:  # of a hull's vertices: with more, the result has too many vertices as well
            corners = np.unique((cells[:, None, :] + _CORNERS).reshape(-1, 3), axis=0)
            vertices = corners[ConvexHull(corners).vertices] * cell
            if len(vertices) <= MOST_VERTICES:
                return vertices, cell * float(np.sqrt(3.0))
        cell *= 2


def embed_hulls(root: ET.Element, packages: Packages, place: str) -> tuple[dict[str, float], list[BadInput]]:
    """Write the hull of every collision mesh into the URDF; existing hulls are kept.

    Returns the largest distance of each hull from its mesh, m, by file, and the errors of unreadable meshes.
    """
    offs: dict[str, float] = {}
    unread: list[BadInput] = []
    hulls: dict[tuple[str, str | None], tuple[Array, float]] = {}  # by file and scale: several links may use them
    for link, mesh in collision_meshes(root):
        if mesh.find("hull") is not None:
            continue
        here, name = f"{place} link {link}", mesh.get("filename", "")
        try:
            key = (name, mesh.get("scale"))
            if key not in hulls:
                points = mesh_points(packages.read(name, here), name, here) * _scale(mesh, here)
                hulls[key] = convex_hull(points)
            vertices, off = hulls[key]
        except BadInput as error:
            unread.append(error)
        except ValueError as error:
            unread.append(BadInput(here, f"mesh {name}: {error}"))
        else:
            write_hull(mesh, vertices)
            offs[name] = max(off, offs.get(name, 0.0))
    return offs, unread


def _scale(mesh: ET.Element, here: str) -> Array:
    text = mesh.get("scale", "1 1 1")
    try:
        scale = np.array([float(part) for part in text.split()])
    except ValueError:
        scale = np.empty(0)
    if scale.shape != (3,) or not np.isfinite(scale).all() or not scale.all():
        raise BadInput(here, f"mesh scale={text!r} is not three numbers other than 0")
    return scale


def link_shapes(link: ET.Element, place: str) -> Iterator[Array]:
    """The vertices (k, 3) of each collision shape of a link, in the link's frame; round shapes by their surface.

    BadInput if a shape is unreadable; meshes need their hull.
    """
    here = f"{place} link {link.get('name')}"
    for collision in link.findall("collision"):
        rotation, translation = read_origin(collision, here)
        geometry = collision.find("geometry")
        if geometry is not None and len(geometry):
            vertices = _vertices(geometry[0], here) @ rotation.T + translation
            reach = np.abs(vertices).max()
            if not reach <= Most.length:
                raise BadInput(here, f"collision <{geometry[0].tag}> reaches {reach:.3g} m, limit {Most.length:g} m")
            yield vertices


def _vertices(shape: ET.Element, here: str) -> Array:
    try:
        if shape.tag == "mesh":
            return read_hull(shape, here)
        if shape.tag == "box":
            return (_CORNERS - 0.5) * np.array(_sizes(shape, "size")).reshape(3)
        if shape.tag == "sphere":
            return _sizes(shape, "radius")[0] * _sphere(200)
        if shape.tag in ("cylinder", "capsule"):
            radius, length = (_sizes(shape, name)[0] for name in ("radius", "length"))
            angle = np.linspace(0, 2 * np.pi, 32, endpoint=False)
            ring = radius * np.stack([np.cos(angle), np.sin(angle), np.zeros(32)], axis=1)
            end = np.array([0, 0, length / 2])
            return np.concatenate([ring + end, ring - end])
    except ValueError as error:
        raise BadInput(here, f"collision <{shape.tag}>: {error}") from None
    raise BadInput(here, f"collision shape <{shape.tag}> is not known")


def _sizes(shape: ET.Element, name: str) -> list[float]:
    """The numbers of an attribute, m, at least one. ValueError if one is not a valid size of a body."""
    text = shape.get(name, "")
    sizes, smallest = [float(part) for part in text.split()] or [0.0], 1e-6  # a flat one has no volume
    if not all(smallest <= size <= Most.length for size in sizes):
        raise ValueError(f"{name}={text[:60]!r} m: limits {smallest:g} and {Most.length:g} m")
    return sizes


def _sphere(count: int) -> Array:
    """Points uniformly distributed on the unit sphere (Fibonacci spiral)."""
    number = np.arange(count) + 0.5
    height, turn = 1 - 2 * number / count, np.pi * (1 + 5**0.5) * number
    radius = np.sqrt(1 - height**2)
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), height], axis=1)


def solid(vertices: Array) -> tuple[float, Array, Array]:
    """Volume m^3, centre (3,) and second moment of volume about the origin (3, 3), m^5, of a hull.

    Sum over tetrahedra from an inner point: for corners a, b, c, d and volume V the second moment is
    V / 20 (s s' + aa' + bb' + cc' + dd') with s = a + b + c + d.
    """
    middle = vertices.mean(0)
    faces = vertices[ConvexHull(vertices).simplices]
    corners = np.concatenate([faces, np.broadcast_to(middle, (len(faces), 1, 3))], axis=1)
    edges = corners[:, :3] - middle
    volumes = np.abs(np.linalg.det(edges)) / 6
    total = corners.sum(1)
    moment = np.einsum("f,fi,fj->ij", volumes, total, total) + np.einsum("f,fki,fkj->ij", volumes, corners, corners)
    volume = float(volumes.sum())
    return volume, (volumes @ total) / 4 / volume, moment / 20


@dataclass(frozen=True)
class Plausible:
    """Inertials that a link may have."""

    density: float = 1000.0
    """kg/m^3, of estimates: the mean of complete arms, including motors, gears and cavities in their hulls. From their
    URDFs: UR5 1377, UR10 1095, xArm7 904, Panda 882, Kinova j2s6s200 815. A single link may be wrong by a factor of 2.
    """
    lightest: float = 1e-3
    """kg: a lighter moving link is a placeholder."""
    densities: tuple[float, float] = (20.0, 2.5e4)
    """kg/m^3, of a hull: foam; tungsten has 19,300."""
    gyrations: tuple[float, float] = (0.02, 1.5)
    """Radius of gyration over the size of the shape: a bar has 0.29, a ring 0.5."""
    gyration: tuple[float, float] = (1e-3, 3.0)
    """m, where there is no shape."""
    compactness: tuple[float, float] = (1.0, 2000.0)
    """kg/m^3, moving mass over the cube of the reach: arms have 20 to 200."""


PLAUSIBLE = Plausible()


def check_inertials(root: ET.Element, place: str) -> tuple[list[UrdfFinding], list[str]]:
    """Findings about the links that move, and those whose inertial is a placeholder or a guess; links without mass get
    an estimate.
    """
    chain = read_chain(ET.tostring(root, encoding="unicode"), place)
    moving = _carried(root, chain)
    links = {name: link for link in root.findall("link") if (name := link.get("name", "")) in moving}
    bodies = {name: _bodies(link, place) for name, link in links.items()}
    found = [one for link in root.findall("link") for one in _impossible(link, bodies.get(link.get("name", "")), place)]
    found += _equal(links, bodies, place)
    for joint, inertial in zip(chain.joints, chain.inertial, strict=True):
        name, mass = joint.link, float(inertial[0])
        if mass >= PLAUSIBLE.lightest:
            if _is_point(inertial):
                found.append(UrdfFinding("unusual", name, f"and what is fixed to it have no inertia: {_WIDER}"))
            continue
        given = links[name].find("inertial") is not None
        if mass > 0:
            found.append(UrdfFinding("unusual", name, f"has a mass of {mass:.3g} kg: a placeholder"))
        lack = "its <inertial> is no body's" if given else "has no <inertial>"
        if not bodies[name]:
            found.append(UrdfFinding("missing", name, f"{lack}, {_why_none(links[name], place)}; {_WIDER}"))
            continue
        guess = PLAUSIBLE.density * _volume(bodies[name])
        _write(links[name], bodies[name], guess)
        sentence = f"{lack}: {guess:.3g} kg, from its shapes at {PLAUSIBLE.density:.0f} kg/m^3; a guess, and {_WIDER}"
        found.append(UrdfFinding("changed", name, sentence))
    return found, [one.place for one in found if one.sentence.endswith(_WIDER)]


def _carried(root: ET.Element, chain: Chain) -> set[str]:
    """The links that the first moving joint carries."""
    children: defaultdict[str, list[str]] = defaultdict(list)
    for joint in root.findall("joint"):
        children[joint_end(joint, "parent", "")].append(joint_end(joint, "child", ""))
    carried = [chain.joints[0].link]
    for link in carried:  # extended during the loop
        carried += children[link]
    return set(carried)


def check_masses(chain: Chain, extent: float) -> list[UrdfFinding]:
    """The moving mass compared with reach and effort limits. `extent`: of the last link from its joint, m."""
    mass = float(chain.inertial[:, 0].sum())
    reach = extent
    for number, joint in enumerate(chain.joints):
        reach += float(np.linalg.norm(joint.translation)) if number else 0.0
        reach += max(abs(joint.lower), abs(joint.upper)) if joint.kind == "prismatic" else 0.0
    compactness = mass / max(reach, 1e-3) ** 3
    found: list[UrdfFinding] = []
    if not PLAUSIBLE.compactness[0] <= compactness <= PLAUSIBLE.compactness[1]:
        sentence = (
            f"moving mass {mass:.4g} kg with a reach of {reach:.3g} m is not plausible: is the unit the kilogram?"
        )
        found.append(UrdfFinding("unusual", "all links", f"{sentence} {_WIDER}"))
    most = np.abs(gravity_efforts(chain, random_poses(chain))).max(axis=0)
    for joint, effort in zip(chain.joints, most, strict=True):
        unit = "N" if joint.kind == "prismatic" else "N m"
        if 0 < joint.effort < effort:
            found.append(
                UrdfFinding(
                    "unusual",
                    joint.name,
                    f"gravity needs up to {effort:.4g} {unit}, above the effort limit of {joint.effort:g} {unit}: "
                    "check mass and limit, or a counterbalance carries it, which a URDF does not contain",
                )
            )
    return found


def random_poses(chain: Chain, room: Array | float = 0.0) -> Array:
    """`POSES` (p, n) at least `room` (n,) from the limits, always the same."""
    low, high = (np.array([getattr(joint, end) for joint in chain.joints]) for end in ("lower", "upper"))
    return np.random.default_rng(1).uniform(low + room, high - room, (POSES, len(low)))


def gravity_efforts(chain: Chain, poses: Array) -> Array:
    """Efforts (p, n) against gravity along -z of the base, in poses (p, n), N m (N)."""
    down = np.array([0.0, 0.0, -9.81])
    rows = [gravity_rows(chain, down, k, poses)[:, 0] for k in range(len(chain.joints))]
    return np.stack(rows, 1) @ chain.inertial.ravel()


def _bodies(link: ET.Element, place: str) -> Bodies:
    """Volume, centre and moment of each shape; none if one is unreadable, which is told elsewhere."""
    try:
        return [solid(shape) for shape in link_shapes(link, place)]
    except BadInput:
        return []


def _why_none(link: ET.Element, place: str) -> str:
    try:
        list(link_shapes(link, place))
    except BadInput as error:
        return f"and its shapes give none: {error.reason}"
    return "and no shape to estimate one from"


def _impossible(link: ET.Element, bodies: Bodies | None, place: str) -> Iterator[UrdfFinding]:
    """Of a link that moves, also what does not fit its shapes; `bodies` is None for the others."""
    parameters, name = read_inertial(link, place), link.get("name", "")
    mass = float(parameters[0])
    if mass < 0 or (mass == 0 and parameters.any()):
        yield UrdfFinding("unusual", name, f"has a mass of {mass:.4g} kg")
    if mass <= 0:
        return
    if mass < PLAUSIBLE.lightest:
        bodies = None
    own, rounding = inertia_at_centre(parameters), 1e-3  # of the largest, by manufacturers
    principal = np.sort(np.linalg.eigvalsh(own))
    if bodies is not None and _is_point(parameters):
        yield UrdfFinding("unusual", name, f"has {mass:.3g} kg and no inertia, which no body has")
        if bodies:
            _write(link, bodies, mass, parameters[1:4] / mass)
            yield UrdfFinding("changed", name, f"the inertia of {mass:.3g} kg in its shapes is used")
    elif principal[0] < -rounding * abs(principal[2]) or principal[2] > (1 + rounding) * (principal[0] + principal[1]):
        shown = ", ".join(f"{value:.3g}" for value in principal)
        yield UrdfFinding("unusual", name, f"no body has its principal inertias {shown} kg m^2")
    elif bodies is not None and (doubt := _doubt(mass, parameters[1:4] / mass, float(np.trace(own)), bodies)):
        yield UrdfFinding("unusual", name, doubt)


def _doubt(mass: float, centre: Array, trace: float, bodies: Bodies) -> str:
    """What in the inertial does not fit the shapes, "" if nothing."""
    gyration = float(np.sqrt(trace / 2 / mass))
    if not bodies:
        what = f"has a radius of gyration of {gyration:.3g} m: is the unit kg m^2?"
        return "" if PLAUSIBLE.gyration[0] <= gyration <= PLAUSIBLE.gyration[1] else what
    volume, (middle, spread) = _volume(bodies), _spread(bodies)
    size = float(np.sqrt(12 * np.linalg.eigvalsh(spread)[-1]))  # of a box with this spread
    if not PLAUSIBLE.densities[0] <= mass / volume <= PLAUSIBLE.densities[1]:
        return f"has {mass:.3g} kg in {1e3 * volume:.3g} dm^3, {mass / volume:.2g} kg/m^3: is the unit the kilogram?"
    if not PLAUSIBLE.gyrations[0] <= gyration / size <= PLAUSIBLE.gyrations[1]:
        return f"has a radius of gyration of {gyration:.3g} m in a shape of {size:.3g} m: is the unit kg m^2?"
    away = float(np.linalg.norm(centre - middle))
    return f"has its centre of mass {away:.3g} m from a shape of {size:.3g} m" if away > 2.0 * size else ""


def _equal(links: dict[str, ET.Element], bodies: dict[str, Bodies], place: str) -> Iterator[UrdfFinding]:
    """Links with one inertial, though their shapes differ in volume, or three and more without shapes."""
    same: defaultdict[tuple[str, ...], list[str]] = defaultdict(list)
    for name, link in links.items():
        parameters = read_inertial(link, place)
        if (mass := float(parameters[0])) > 10 * PLAUSIBLE.lightest:
            same[tuple(f"{value:.6g}" for value in (mass, *inertia_at_centre(parameters).ravel()))].append(name)
    for (mass, *_), names in same.items():
        volumes = [_volume(bodies[name]) for name in names if bodies[name]]
        ratio = max(volumes, default=1.0) / min(volumes, default=1.0)
        if len(names) > 1 and (ratio > 2.0 or (len(names) > 2 and not volumes)):
            shapes = f", though their shapes differ {ratio:.3g} times in volume" if volumes else ""
            sentence = f"all have the same inertial of {mass} kg{shapes}: a placeholder; {_WIDER}"
            yield UrdfFinding("unusual", ", ".join(names), sentence)


def _is_point(parameters: Array) -> bool:
    """Its radius of gyration is rounding, below 10 um."""
    return bool(np.abs(inertia_at_centre(parameters)).max() < parameters[0] * 1e-5**2)


def _volume(bodies: Bodies) -> float:
    return float(sum(volume for volume, _, _ in bodies))


def _spread(bodies: Bodies) -> tuple[Array, Array]:
    """Centre (3,) of the shapes, m, and the second moment of volume about it over the volume (3, 3), m^2."""
    volume = _volume(bodies)
    centre = sum((own * at for own, at, _ in bodies), np.zeros(3)) / volume
    return centre, sum((moment for _, _, moment in bodies), np.zeros((3, 3))) / volume - np.outer(centre, centre)


def _write(link: ET.Element, bodies: Bodies, mass: float, centre: Array | None = None) -> None:
    """Replace the link's inertial by that of a homogeneous body with its shapes; `centre`: where it is known."""
    middle, spread = _spread(bodies)
    tensor = mass * (np.trace(spread) * np.eye(3) - spread)
    for element in link.findall("inertial"):
        link.remove(element)
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(
        inertial, "origin", xyz=" ".join(f"{x:.6g}" for x in (middle if centre is None else centre)), rpy="0 0 0"
    )
    ET.SubElement(inertial, "mass", value=f"{mass:.6g}")
    entries = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    ET.SubElement(inertial, "inertia", {key: f"{tensor[entry]:.9g}" for key, entry in entries.items()})
