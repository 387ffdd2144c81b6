"""Builds folders that get their name only when they are complete, and copies files into them."""

import hashlib
import shutil
import sqlite3
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from service.model.errors import BadInput, SweepidError
from service.store.backup.manifest import StoredFile
from service.store.files.atomic_files import place_folder, sync

PARTIAL = ".partial"
_CHUNK = 2**20  # bytes


class NotCopied(SweepidError):
    """The disk did not accept or deliver data; the incomplete copy was removed."""


@contextmanager
def building(target: Path) -> Generator[Path]:
    """A new folder next to `target` that is renamed to it at the end of the block, after all content is on the disk.

    If the block raises, the folder is removed; if the process is killed it stays, named ``.NAME.partial``. BadInput if
    such a folder exists, or the parent folder does not. NotCopied instead of OSError and sqlite3.Error.
    """
    partial = target.with_name(f".{target.name}{PARTIAL}")
    try:
        partial.mkdir()
    except FileExistsError:
        reason = "is left over from a killed run, or in use by another run: remove it if no other run is active"
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
    """Copy a file into a folder, which is created if necessary; the content is on the disk at return. OSError."""
    target.parent.mkdir(parents=True, exist_ok=True)
    digest, size = hashlib.sha256(), 0
    with source.open("rb") as read, target.open("xb") as written:
        while chunk := read.read(_CHUNK):
            digest.update(chunk)
            size += written.write(chunk)
    sync(target)
    return StoredFile(size=size, sha256=digest.hexdigest())
