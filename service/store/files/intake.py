"""Task of a reader process for an external bundle: unpack it, read all of it, store its recordings."""

import errno
import shutil
import zipfile
import zlib
from pathlib import Path
from typing import Annotated, Any
from uuid import uuid4

from pydantic import BaseModel, ConfigDict, StringConstraints

from service.model.errors import BadInput
from service.model.recording import SweepSpec
from service.model.robot import RobotDescription
from service.store.documents import NewRecording, RecordingState
from service.store.files.bundle import Bundle, read_bundle
from service.store.files.recordings import RecordingFiles

_MAX_UNPACKED = 4 * 2**30  # bytes; a small zip can contain a very large file
_MOST_MEMBERS = 20_000  # of an archive
# LZMA allocates the dictionary size stated by the member, up to 4 GiB, before it reads a byte
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2)
# a name that is too long, a file that is also a folder, an offset before the archive; None: bad bzip2 data.
# Other codes, such as a full disk, are errors of this computer
_BAD_MEMBER = (errno.ENAMETOOLONG, errno.ENOTDIR, errno.EISDIR, errno.EEXIST, errno.EINVAL, None)


class SavedBundle(BaseModel):
    """A bundle whose samples are already in files, one recording per sweep; `folder`: the name of their folder."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    robot: RobotDescription
    urdf_text: str
    sweeps: tuple[SweepSpec, ...]
    recordings: tuple[NewRecording, ...]
    folder: Annotated[str, StringConstraints(pattern="^import-[0-9a-f]{32}$")]  # set by the reader


def save_bundle(files: RecordingFiles, bundle: Bundle) -> SavedBundle:
    """Write the recordings of a bundle to a new folder; all of them or nothing."""
    name = f"import-{uuid4().hex}"
    folder = files.folder(name)
    try:
        recordings = tuple(
            files.save(
                folder / f"{number:04d}-1.parquet",
                sweep.recording,
                RecordingState.COMPLETE,
                {"robot": bundle.robot.name, "spec": sweep.spec.model_dump(mode="json")},
            )
            for number, sweep in enumerate(bundle.sweeps, 1)
        )
    except BaseException:
        shutil.rmtree(folder)
        raise
    return SavedBundle(
        robot=bundle.robot.description,
        urdf_text=bundle.robot.urdf_text,
        sweeps=tuple(sweep.spec for sweep in bundle.sweeps),
        recordings=recordings,
        folder=name,
    )


def take_in(source: Path, work: Path) -> dict[str, Any]:
    """`save_bundle` of a bundle (its folder or a zip of it) below `work`, an empty folder, as JSON."""
    return save_bundle(RecordingFiles(work), read_from(source, work / "bundle")).model_dump(mode="json")


def read_from(source: Path, folder: Path) -> Bundle:
    """The bundle in a folder or a zip, which is unpacked into `folder`; BadInput then names places in the bundle."""
    if source.is_dir():
        return read_bundle(source)
    _unpack(source, folder)
    inner = [folder, *(path.parent for path in folder.glob("*/bundle.json"))]  # of a folder that was zipped as a whole
    try:
        return read_bundle(inner[1] if len(inner) == 2 and not (folder / "bundle.json").exists() else folder)
    except BadInput as error:  # the sender knows the bundle, not this folder
        raise BadInput(_own_place(error.place, folder), _own_place(error.reason, folder)) from None


def _unpack(archive: Path, folder: Path) -> None:
    """Unpack into `folder`; `zipfile` itself removes path components that would leave it."""
    try:
        with zipfile.ZipFile(archive) as content:
            members = content.infolist()
            if len(members) > _MOST_MEMBERS:
                raise BadInput("bundle", f"has {len(members)} files, limit {_MOST_MEMBERS}")
            for member in members:
                member.filename = member.filename.replace("\\", "/")  # of a program of Windows
                if member.compress_type not in _METHODS:
                    raise BadInput(
                        f"bundle {member.filename[:60]!r}",
                        f"is compressed by method {member.compress_type} of zip, which is not read; compress it by "
                        "deflate (8) or bzip2 (12), or store it (0)",
                    )
            size = sum(member.file_size for member in members)
            if size > _MAX_UNPACKED:
                raise BadInput("bundle", f"unpacks to {size} bytes, limit {_MAX_UNPACKED} bytes")
            content.extractall(folder, members)
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError) as error:
        raise BadInput("bundle", f"cannot be unpacked: {error}") from None
    except OSError as error:
        if error.errno not in _BAD_MEMBER:
            raise
        raise BadInput("bundle", f"cannot be unpacked: {error.strerror or error}") from None


def _own_place(text: str, folder: Path) -> str:
    return text.replace(f"{folder}/", "").replace(str(folder), "bundle")
