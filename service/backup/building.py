"""Folders that come to their place whole or not at all, and the copying into them."""

import hashlib
import shutil
import sqlite3
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from service.backup.manifest import StoredFile
from service.errors import BadInput, SweepidError
from service.store.files.placing import place_folder, sync

PARTIAL = ".partial"
_CHUNK = 2**20  # bytes


class NotCopied(SweepidError):
    """The disk did not take it, or could not be read; what was written of the copy is gone again."""


@contextmanager
def building(target: Path) -> Generator[Path]:
    """A new folder beside `target` that takes its name when the block is left, on the disk with all that is in it.

    Where the block raises, the folder goes; of a process that is killed it stays, named ``.NAME.partial``. BadInput if
    there is such a one, or no folder to build it in. NotCopied instead of OSError and sqlite3.Error.
    """
    partial = target.with_name(f".{target.name}{PARTIAL}")
    try:
        partial.mkdir()
    except FileExistsError:
        reason = "was left by a run that was killed, or one is at work: remove it if none is"
        raise BadInput(str(partial), reason) from None
    except OSError as error:
        raise BadInput(str(target), f"cannot be made in {target.parent}: {error.strerror or error}") from None
    try:
        yield partial
        for folder in (path for path in partial.rglob("*") if path.is_dir()):
            sync(folder)
        sync(partial)
        place_folder(partial, target)
    except BaseException as error:
        shutil.rmtree(partial, ignore_errors=True)
        if isinstance(error, OSError | sqlite3.Error):
            raise NotCopied(f"{target} was not written: {error}") from error
        raise


def copy_file(source: Path, target: Path) -> StoredFile:
    """Copy a file into a folder that is made if need be; what was written is on the disk. OSError."""
    target.parent.mkdir(parents=True, exist_ok=True)
    digest, size = hashlib.sha256(), 0
    with source.open("rb") as read, target.open("xb") as written:
        while chunk := read.read(_CHUNK):
            digest.update(chunk)
            size += written.write(chunk)
    sync(target)
    return StoredFile(size=size, sha256=digest.hexdigest())
