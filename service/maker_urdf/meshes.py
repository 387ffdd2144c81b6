"""The points of a mesh file. Its convex hull needs no more: no faces, normals, materials.

STL (3D Systems 1989: binary with 50 bytes a triangle after a head of 84, or text) and OBJ (Wavefront: lines `v x y z`)
are read here, DAE in `collada`. A library that reads them all would be a dependency for these few lines.
"""

from pathlib import PurePosixPath

import numpy as np
from numpy.typing import NDArray

from service.errors import BadInput
from service.maker_urdf.collada import collada_points

Array = NDArray[np.float64]

KINDS = (".stl", ".obj", ".dae")
_HEAD, _TRIANGLE = 84, 50


def mesh_points(content: bytes, name: str, place: str) -> Array:
    """Points (n, 3) of a mesh file in its own unit (DAE: m); BadInput where it has none or not all are numbers."""
    kind = PurePosixPath(name).suffix.lower()
    if kind not in KINDS:
        raise BadInput(place, f"mesh {name}: is not one of {', '.join(KINDS)}")
    here = f"{place} mesh {name}"
    try:
        points = {".stl": _stl, ".obj": _obj, ".dae": collada_points}[kind](content, here)
    except (ValueError, LookupError) as error:  # the latter also for an XML encoding that is none of text
        raise BadInput(here, f"cannot be read: {error}") from None
    if not len(points):
        raise BadInput(here, "has no points")
    if not np.isfinite(points).all():
        raise BadInput(here, "has a point that is not finite")
    return points


def _stl(content: bytes, here: str) -> Array:
    triangles = int.from_bytes(content[80:_HEAD], "little")
    if len(content) == _HEAD + _TRIANGLE * triangles:  # a binary head may begin with "solid" as well
        records = np.frombuffer(content, np.uint8, offset=_HEAD).reshape(triangles, _TRIANGLE)
        return records[:, 12:48].copy().view("<f4").reshape(-1, 3).astype(np.float64)
    if content.lstrip()[:5].lower() != b"solid":
        raise BadInput(here, f"is cut off: {triangles} triangles told in {len(content)} bytes")
    return _vectors(content, b"vertex")


def _obj(content: bytes, _: str) -> Array:
    return _vectors(content, b"v")


def _vectors(content: bytes, word: bytes) -> Array:
    """The first three numbers of every line that begins with `word`; ValueError if there are fewer or others."""
    rows = [parts[1:4] for line in content.splitlines() if (parts := line.split()) and parts[0].lower() == word]
    if any(len(row) != 3 for row in rows):
        raise ValueError("a point has fewer than three numbers")
    return np.array([[float(number) for number in row] for row in rows]).reshape(-1, 3)
