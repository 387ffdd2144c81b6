"""Files of a robot's manufacturer: packages of ROS by name, xacro, and the points of mesh files.

No mesh outside the package folders is read. A convex hull needs no faces, normals or materials, so a mesh is its
points: STL (3D Systems 1989: binary with a header of 84 bytes and 50 bytes per triangle, or text), OBJ (Wavefront:
lines `v x y z`) and COLLADA (Khronos, "COLLADA Digital Asset Schema 1.4.1"), whose points are placed in the scene, in
m; its up direction is ignored, as usual for a URDF. A mesh library would be a large dependency for these few lines.
"""

import glob
import io
import re
import sys
import xml.etree.ElementTree as ET
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from types import ModuleType
from typing import cast
from unittest.mock import patch
from xml.dom.minidom import Document

import numpy as np
import xacro
from numpy.typing import NDArray

from service import BadInput
from service.model import Array, rotation_about
from service.model.configuration import read_text


@dataclass(frozen=True, slots=True)
class MeshLimits:
    """Of one mesh file, which may be made to use up memory or time."""

    size: int = 64 * 2**20
    """Bytes."""
    points: int = 500_000
    """Different ones; the hull of so many takes about ten seconds."""
    elements: int = 500_000
    """XML elements of a COLLADA file."""
    characters: int = 2**24
    """Of one list of numbers in it."""
    depth: int = 100
    """Levels of nested nodes."""
    nodes: int = 10_000
    """In the scene: instances of instances can grow exponentially with depth."""
    shown: int = 4_000_000
    """Points in the scene."""


LIMITS = MeshLimits()


class Packages:
    """Folders that contain packages, or are one; `package://NAME/PATH` is the file PATH of the package NAME.

    A package is called as its package.xml says, or as its folder. A name without a scheme is relative to the folder of
    the URDF, and must also be in a package folder.
    """

    def __init__(self, folders: Sequence[Path], beside: Path, named: Mapping[str, Path] | None = None) -> None:
        """`beside`: the folder of the URDF; `named`: folders of packages. BadInput if a folder is none."""
        self._named = {name: folder.resolve() for name, folder in (named or {}).items()}
        for folder in (*folders, *self._named.values()):
            if not folder.is_dir():
                raise BadInput(str(folder), "is not a folder of packages")
        self._folders = (*(folder.resolve() for folder in folders), *self._named.values())
        self._beside = beside.resolve()

    def folder(self, package: str, place: str) -> Path:
        """The folder of a package; BadInput if there is none."""
        for folder in self._of(package):
            if folder.is_dir():
                return folder
        shown = ", ".join(map(str, self._folders)) or "none was given"
        raise BadInput(
            place, f"package {package} is not in the package folders ({shown}): give it by --package {package}=FOLDER"
        )

    def _of(self, package: str) -> Iterator[Path]:
        """Folders that may be the package."""
        if package in self._named:
            yield self._named[package]
        yield from (folder for folder in self._folders if folder.name == package)
        for folder in self._folders:
            for depth in range(5):  # levels of folders: workspace, src, repository, package
                yield from folder.glob("*/" * depth + glob.escape(package))
                for found in sorted(folder.glob("*/" * depth + "package.xml")):
                    name = re.search(rb"<name>\s*([^<\s]+)\s*</name>", re.sub(rb"(?s)<!--.*?-->", b"", _head(found)))
                    if name and name[1].decode(errors="replace") == package:
                        yield found.parent

    def read(self, name: str, place: str) -> bytes:
        """The file; BadInput names the mesh if it does not exist, is too large, or outside the package folders."""
        for candidate in self._candidates(name, place):
            try:
                found = candidate.resolve(strict=True)
            except (OSError, RuntimeError, ValueError):  # missing, circular links, a NUL in the name
                continue
            if not any(found.is_relative_to(folder) for folder in self._folders):
                raise BadInput(place, f"mesh {name}: lies outside of the package folders")
            return _content(found, name, place)
        shown = ", ".join(map(str, self._folders)) or "none was given"
        raise BadInput(place, f"mesh {name}: no such file in the package folders ({shown})")

    def _candidates(self, name: str, place: str) -> Iterator[Path]:
        if ".." in PurePosixPath(name.replace("\\", "/")).parts:
            raise BadInput(place, f"mesh {name}: '..' leads out of a package")
        if name.startswith("package://"):
            package, _, path = name.removeprefix("package://").partition("/")
            if not package or not path:
                raise BadInput(place, f"mesh {name}: is not package://PACKAGE/FILE")
            return (folder / path for folder in self._of(package))
        if "://" in name.removeprefix("file://"):
            raise BadInput(place, f"mesh {name}: only package://PACKAGE/FILE or a path beside the URDF is read")
        return iter([self._beside / name.removeprefix("file://")])


def _head(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(65536)
    except OSError:
        return b""


def _content(path: Path, name: str, place: str) -> bytes:
    try:
        if not path.is_file():
            raise BadInput(place, f"mesh {name}: is not a file")
        with path.open("rb") as file:
            content = file.read(LIMITS.size + 1)
    except OSError as error:
        raise BadInput(place, f"mesh {name}: cannot be read: {error.strerror or error}") from None
    if len(content) > LIMITS.size:
        raise BadInput(place, f"mesh {name}: is larger than {LIMITS.size // 2**20} MiB")
    return content


def read_description(path: Path, packages: Packages, arguments: Mapping[str, str]) -> str:
    """The URDF in a file. A xacro file is expanded: ``$(find NAME)`` is the folder of that package.

    BadInput names the file that cannot be read or expanded, the argument without value, or the unknown package.
    """
    text = read_text(path)
    if path.suffix != ".xacro" and "<xacro:" not in text:
        return text

    def share(name: str) -> str:
        return str(packages.folder(name, str(path)))

    finder = ModuleType("ament_index_python.packages")
    vars(finder)["get_package_share_directory"] = share
    try:
        with patch.dict(sys.modules, {"ament_index_python": finder, finder.__name__: finder}):
            expand = cast(Callable[..., Document], vars(xacro)["process_file"])
            return expand(str(path), mappings=dict(arguments)).toxml()
    except Exception as error:  # noqa: BLE001 - the expressions in the file may raise any
        raise _refusal(error, path) from None


def _refusal(error: BaseException, path: Path) -> BadInput:
    cause = error
    while (inner := getattr(cause, "exc", None)) is not None:
        cause = inner
    if isinstance(cause, BadInput):
        return cause
    files: list[str] = getattr(xacro, "filestack", None) or [str(path)]
    if type(cause).__name__ == "ArgException":
        return BadInput(files[-1], f"argument {cause} has no value: give it by --xacro-arg {cause}:=VALUE")
    return BadInput(files[-1], f"xacro: {' '.join(str(error).split()) or repr(error)}")


def mesh_points(content: bytes, name: str, place: str) -> Array:
    """Points (n, 3) of a mesh file in its own unit (DAE: m); BadInput if there are none or some are not numbers."""
    kind = PurePosixPath(name).suffix.lower()
    readers = {".stl": _stl, ".obj": _obj, ".dae": _collada}
    if kind not in readers:
        raise BadInput(place, f"mesh {name}: is not one of {', '.join(readers)}")
    here = f"{place} mesh {name}"
    try:
        points = readers[kind](content, here)
    except (ValueError, LookupError) as error:  # LookupError also for an unknown XML encoding
        raise BadInput(here, f"cannot be read: {error}") from None
    if not len(points):
        raise BadInput(here, "has no points")
    if not np.isfinite(points).all():
        raise BadInput(here, "has a point that is not finite")
    if len(points) > LIMITS.points:
        points = np.unique(points, axis=0)  # an STL file repeats each corner in every triangle
    if len(points) > LIMITS.points:
        raise BadInput(here, f"has {len(points)} different points, limit {LIMITS.points}; make it coarser")
    return points


def _stl(content: bytes, here: str) -> Array:
    triangles = int.from_bytes(content[80:84], "little")
    if len(content) == 84 + 50 * triangles:  # a binary header may also begin with "solid"
        records = np.frombuffer(content, np.uint8, offset=84).reshape(triangles, 50)
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


class _Bounded(ET.TreeBuilder):
    """Builder for the XML parser. ValueError for a DOCTYPE, whose entities may expand, and for too many elements."""

    _elements = 0

    def start(self, tag: str, attrs: dict[str, str], /) -> ET.Element:
        self._elements += 1
        if self._elements > LIMITS.elements:
            raise ValueError(f"has more than {LIMITS.elements} elements")
        return super().start(tag, attrs)

    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        raise ValueError("declares a DOCTYPE; entities are not expanded")


def _collada(content: bytes, here: str) -> Array:
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
        if count > LIMITS.shown:
            raise BadInput(here, f"shows more than {LIMITS.shown} points")
        parts.append(points @ transform[:3, :3].T + transform[:3, 3])
    return metres * np.concatenate([np.empty((0, 3)), *parts])


class _Visits:
    """Counts nodes in the scene, including empty ones."""

    def __init__(self, here: str) -> None:
        self._here, self._count = here, 0

    def one_more(self, depth: int) -> None:
        """BadInput above the limits."""
        self._count += 1
        if depth > LIMITS.depth:
            raise BadInput(self._here, f"nodes are nested deeper than {LIMITS.depth}")
        if self._count > LIMITS.nodes:
            raise BadInput(self._here, f"shows more than {LIMITS.nodes} nodes and geometries")


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
            axis, angle = _numbers(element)[:3], np.deg2rad(_numbers(element)[3])
            own[:3, :3] = rotation_about(axis / max(float(np.linalg.norm(axis)), 1e-12), angle)
        elif element.tag in ("lookat", "skew"):
            raise ValueError(f"<{element.tag}> is not supported")
        whole = whole @ own
    return whole


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
    if len(text) > LIMITS.characters:
        raise ValueError(f"<{element.tag}> has {len(text)} characters, limit {LIMITS.characters}")
    return text
