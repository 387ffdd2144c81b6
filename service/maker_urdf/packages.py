"""Mesh files by their names in a URDF. No file outside the package folders is read."""

from collections.abc import Sequence
from pathlib import Path, PurePosixPath

from service.errors import BadInput

LARGEST_MESH = 64 * 1024 * 1024  # bytes
_SCHEME = "package://"


class Packages:
    """Folders that contain packages, or are one; `package://NAME/PATH` is the file PATH of the folder NAME.

    A name without a scheme is relative to the folder of the URDF, and must also be in a package folder.
    """

    def __init__(self, folders: Sequence[Path], beside: Path) -> None:
        """`beside`: the folder of the URDF. BadInput if a package folder is not a folder."""
        for folder in folders:
            if not folder.is_dir():
                raise BadInput(str(folder), "is not a folder of packages")
        self._folders = tuple(folder.resolve() for folder in folders)
        self._beside = beside.resolve()

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

    def _candidates(self, name: str, place: str) -> list[Path]:
        if ".." in PurePosixPath(name.replace("\\", "/")).parts:
            raise BadInput(place, f"mesh {name}: '..' leads out of a package")
        if name.startswith(_SCHEME):
            package, _, path = name.removeprefix(_SCHEME).partition("/")
            if not package or not path:
                raise BadInput(place, f"mesh {name}: is not {_SCHEME}PACKAGE/FILE")
            own = [folder / path for folder in self._folders if folder.name == package]
            return [*own, *(folder / package / path for folder in self._folders)]
        if "://" in name:
            raise BadInput(place, f"mesh {name}: only {_SCHEME}PACKAGE/FILE or a path beside the URDF is read")
        return [self._beside / name]


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
