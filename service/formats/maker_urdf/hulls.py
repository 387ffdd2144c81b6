"""Convex hulls: from points, into the URDF (`<mesh>` gets a child `<hull>`), and their volume and inertia.

A hull may have more points than the mesh, and always contains all of it: every point is replaced by the eight
corners of the grid cell that contains it. The hull is at most one cell diagonal larger.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from service.formats.maker_urdf.meshes import mesh_points
from service.formats.maker_urdf.packages import Packages
from service.model.errors import BadInput
from service.model.urdf import LARGEST, collision_meshes, read_hull, read_origin, write_hull

Array = NDArray[np.float64]

FINEST = 1e-4  # m, edge of the grid's cells
SMALLEST = 1e-6  # m, of a box, cylinder or sphere: a flat one has no volume
MOST_VERTICES = 250  # of a hull; with more, the cells are made larger
MOST_CELLS = 20_000  # of which a hull is made
_CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)


def convex_hull(points: Array) -> tuple[Array, float]:
    """Vertices (k, 3) of a convex body that contains all points (n, 3), and its largest distance from them, m.

    ValueError for points farther than `LARGEST` from the origin.
    """
    if np.abs(points).max() > LARGEST:
        raise ValueError(f"reaches {np.abs(points).max():.3g} m from its origin")
    with suppress(QhullError):  # flat: the cells give it a thickness
        points = points[ConvexHull(points).vertices]
    cell = FINEST
    while True:
        cells = np.unique(np.floor(points / cell), axis=0)
        if len(cells) <= MOST_CELLS:  # of a hull's vertices: with more, the result has too many vertices as well
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
            if not np.abs(vertices).max() <= LARGEST:
                raise BadInput(
                    here, f"collision <{geometry[0].tag}> reaches {np.abs(vertices).max():.3g} m, limit {LARGEST:g} m"
                )
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
    sizes = [float(part) for part in text.split()] or [0.0]
    if not all(SMALLEST <= size <= LARGEST for size in sizes):
        raise ValueError(f"{name}={text[:60]!r} m: limits {SMALLEST:g} and {LARGEST:g} m")
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
