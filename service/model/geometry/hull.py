"""Convex hulls inside a URDF: `<mesh filename="..."><hull vertices="x y z ..."/></mesh>`.

A URDF contains names of mesh files, not the meshes. `sweepid robot check`, run where the files are, writes the hulls of
the collision meshes into it. Then only the text is needed: in the store, in a bundle, in another process.
Vertices are in m in the frame of the shape's `<origin>`, with the mesh's scale applied. Other URDF readers ignore it.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from service.model.errors import BadInput

Array = NDArray[np.float64]

MOST_NUMBERS = 30_000  # of one hull
LARGEST = 1e4  # m, of a coordinate


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
    name, element = mesh.get("filename", ""), mesh.find("hull")
    if element is None:
        raise BadInput(
            here, f"mesh {name}: its shape is not in the URDF; `sweepid robot check URDF --packages DIR` puts it in"
        )
    words = element.get("vertices", "").split(maxsplit=MOST_NUMBERS)
    if len(words) > MOST_NUMBERS:
        raise BadInput(here, f"mesh {name}: its hull has more than {MOST_NUMBERS} numbers")
    try:
        numbers = np.array([float(word) for word in words])
    except ValueError as error:
        raise BadInput(here, f"mesh {name}: hull: {error}") from None
    if len(numbers) % 3 or not np.isfinite(numbers).all():
        raise BadInput(here, f"mesh {name}: its hull is not finite numbers in threes")
    if np.abs(numbers).max(initial=0.0) > LARGEST:
        raise BadInput(here, f"mesh {name}: its hull reaches {np.abs(numbers).max():.3g} m, limit {LARGEST:g} m")
    vertices = numbers.reshape(-1, 3)
    if len(vertices) < 4 or np.linalg.matrix_rank(vertices - vertices[:1], tol=1e-9) < 3:
        raise BadInput(here, f"mesh {name}: its hull is not a body: {len(vertices)} points, or all in one plane")
    return vertices
