"""What a backup holds: ``manifest.json``, written last, beside ``data/``, which is laid out as a data folder is.

::

    BACKUP/manifest.json
    BACKUP/data/sweepid.sqlite
    BACKUP/data/database.json
    BACKUP/data/recordings/campaign-000001/0001-1.parquet ...
"""

from datetime import datetime
from pathlib import Path, PurePosixPath
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, StringConstraints, ValidationError

from service.errors import BadInput

FILE = "manifest.json"
DATA = "data"


def inside(path: str) -> str:
    """`path` if it stays in the folder that it is relative to; ValueError."""
    parts = PurePosixPath(path).parts
    if not parts or "\0" in path or PurePosixPath(path).is_absolute() or ".." in parts:
        raise ValueError(f"{path!r} does not stay in its folder")
    return path


class StoredFile(BaseModel):
    """Size in bytes and SHA-256 of a file."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    size: int = Field(ge=0)
    sha256: Annotated[str, StringConstraints(pattern="^[0-9a-f]{64}$")]


class Manifest(BaseModel):
    """The files by path below ``data/``; `streams_left_out` were under way, or left by a service that died."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    format: Literal[1] = 1
    made_at: datetime
    schema_version: str
    database: str | None
    files: dict[Annotated[str, AfterValidator(inside)], StoredFile]
    streams_left_out: tuple[str, ...]

    @property
    def size(self) -> int:
        """Bytes of all files."""
        return sum(file.size for file in self.files.values())


def read_manifest(backup: Path) -> Manifest:
    """BadInput for a folder that is no backup, or is not a whole one."""
    place = backup / FILE
    try:
        return Manifest.model_validate_json(place.read_bytes())
    except (FileNotFoundError, NotADirectoryError):
        raise BadInput(str(backup), f"is not a whole backup: it has no {FILE}") from None
    except OSError as error:
        raise BadInput(str(place), f"cannot be read: {error.strerror or error}") from None
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise BadInput(str(place), f"is not the manifest of a backup: {where} {first['msg']}".rstrip()) from None
