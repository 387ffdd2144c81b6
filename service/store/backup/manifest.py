"""The content of a backup: ``manifest.json``, written last, next to ``data/``, which has the layout of a data folder.

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

from service.model.errors import BadInput

FILE = "manifest.json"
DATA = "data"
LARGEST = 2**26  # bytes: of some 300,000 recordings


Sha256 = Annotated[str, StringConstraints(pattern="^[0-9a-f]{64}$")]


def inside(path: str) -> str:
    """`path` if it stays in the folder that it is relative to; otherwise ValueError."""
    parts = PurePosixPath(path).parts
    if not parts or "\0" in path or PurePosixPath(path).is_absolute() or ".." in parts:
        raise ValueError(f"{path!r} leads out of its folder")
    return path


class StoredFile(BaseModel):
    """Size in bytes and SHA-256 of a file."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    size: int = Field(ge=0)
    sha256: Sha256


class Manifest(BaseModel):
    """The files by path below ``data/``; `streams_left_out` were being recorded, or left by a service that crashed.

    `in_store`: SHA-256 by path of the recordings that were only in the object store. They are not in the backup.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")
    format: Literal[1] = 1
    made_at: datetime
    schema_version: str
    database: str | None
    files: dict[Annotated[str, AfterValidator(inside)], StoredFile]
    streams_left_out: tuple[str, ...]
    in_store: dict[Annotated[str, AfterValidator(inside)], Sha256] = Field(default_factory=dict)

    @property
    def size(self) -> int:
        """Bytes of all files."""
        return sum(file.size for file in self.files.values())


def read_manifest(backup: Path) -> Manifest:
    """BadInput for a folder that is not a backup, or not a complete one."""
    place = backup / FILE
    try:
        with place.open("rb") as file:
            content = file.read(LARGEST + 1)
        if len(content) > LARGEST:
            raise BadInput(str(place), f"is larger than {LARGEST} bytes")
        return Manifest.model_validate_json(content)
    except (FileNotFoundError, NotADirectoryError):
        raise BadInput(str(backup), f"is not a complete backup: {FILE} is missing") from None
    except OSError as error:
        raise BadInput(str(place), f"cannot be read: {error.strerror or error}") from None
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise BadInput(str(place), f"is not the manifest of a backup: {where} {first['msg']}".rstrip()) from None
