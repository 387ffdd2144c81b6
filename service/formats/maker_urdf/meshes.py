"""The points of a mesh file. Its convex hull needs no faces, normals or materials.

STL (3D Systems 1989: binary with a header of 84 bytes and 50 bytes per triangle, or text) and OBJ (Wavefront: lines
`v x y z`) are read here, DAE in `collada`. A mesh library would be a large dependency for these few lines.
"""

import io
from array import array
from pathlib import PurePosixPath

import numpy as np
from numpy.typing import NDArray

from service.formats.maker_urdf.collada import collada_points
from service.model.errors import BadInput

Array = NDArray[np.float64]

KINDS = (".stl", ".obj", ".dae")
MOST_POINTS = 500_000  # different ones; the hull of so many takes about ten seconds
_HEAD, _TRIANGLE = 84, 50


def mesh_points(content: bytes, name: str, place: str) -> Array:
    """Points (n, 3) of a mesh file in its own unit (DAE: m); BadInput if there are none or some are not numbers."""
    kind = PurePosixPath(name).suffix.lower()
    if kind not in KINDS:
        raise BadInput(place, f"mesh {name}: is not one of {', '.join(KINDS)}")
    here = f"{place} mesh {name}"
    try:
        points = {".stl": _stl, ".obj": _obj, ".dae": collada_points}[kind](content, here)
    except (ValueError, LookupError) as error:  # LookupError also for an unknown XML encoding
        raise BadInput(here, f"cannot be read: {error}") from None
    if not len(points):
        raise BadInput(here, "has no points")
    if not np.isfinite(points).all():
        raise BadInput(here, "has a point that is not finite")
    if len(points) > MOST_POINTS:
        points = np.unique(points, axis=0)  # an STL file repeats each corner in every triangle
    if len(points) > MOST_POINTS:
        raise BadInput(here, f"has {len(points)} different points, limit {MOST_POINTS}; make it coarser")
    return points


def _stl(content: bytes, here: str) -> Array:
    triangles = int.from_bytes(content[80:_HEAD], "little")
    if len(content) == _HEAD + _TRIANGLE * triangles:  # a binary header may also begin with "solid"
        records = np.frombuffer(content, np.uint8, offset=_HEAD).reshape(triangles, _TRIANGLE)
        return records[:, 12:48].copy().view("<f4").reshape(-1, 3).astype(np.float64)
    if content.lstrip()[:5].lower() != b"solid":
        raise BadInput(here, f"is incomplete: {triangles} triangles declared in {len(content)} bytes")
    return _vectors(content, b"vertex")


def _obj(content: bytes, _: str) -> Array:
    return _vectors(content, b"v")


def _vectors(content: bytes, word: bytes) -> Array:
    """The first three numbers of every line that begins with `word`; ValueError if there are fewer or invalid ones.

    Line by line, because a list of all lines and words needs thirty times the file size.
    """
    numbers = array("d")
    for line in io.BytesIO(content.replace(b"\r", b"\n")):
        parts = line.split(maxsplit=4)
        if parts and parts[0].lower() == word:
            if len(parts) < 4:
                raise ValueError("a point has fewer than three numbers")
            numbers.extend(float(number) for number in parts[1:4])
    return np.array(numbers, dtype=np.float64).reshape(-1, 3)
