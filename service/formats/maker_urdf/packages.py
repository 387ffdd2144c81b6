"""Packages of ROS by name, and their mesh files. No mesh outside the package folders is read."""

import glob
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path, PurePosixPath

from service.model.errors import BadInput

DEEPEST = 5  # levels of folders in which package.xml is searched: workspace, src, repository, package
LARGEST_MESH = 64 * 1024 * 1024  # bytes
_SCHEME = "package://"


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
            for depth in range(DEEPEST):
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
        if name.startswith(_SCHEME):
            package, _, path = name.removeprefix(_SCHEME).partition("/")
            if not package or not path:
                raise BadInput(place, f"mesh {name}: is not {_SCHEME}PACKAGE/FILE")
            return (folder / path for folder in self._of(package))
        if "://" in name.removeprefix("file://"):
            raise BadInput(place, f"mesh {name}: only {_SCHEME}PACKAGE/FILE or a path beside the URDF is read")
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
            content = file.read(LARGEST_MESH + 1)
    except OSError as error:
        raise BadInput(place, f"mesh {name}: cannot be read: {error.strerror or error}") from None
    if len(content) > LARGEST_MESH:
        raise BadInput(place, f"mesh {name}: is larger than {LARGEST_MESH // 2**20} MiB")
    return content
