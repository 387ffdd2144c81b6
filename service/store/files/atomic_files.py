"""A file gets its name only when it is complete."""

import os
from pathlib import Path


def place_new(partial: Path, path: Path) -> None:
    """As `place`, but raises FileExistsError, and changes nothing, if the path exists."""
    sync(partial)
    try:
        os.link(partial, path)
    except FileExistsError:
        raise
    except OSError:  # a file system without links: the name is reserved first
        path.open("xb").close()
        partial.replace(path)
    partial.unlink(missing_ok=True)
    sync(path.parent)


def place(partial: Path, path: Path) -> None:
    """Move a finished file to its path so that after a power failure the whole file or none exists."""
    sync(partial)
    partial.replace(path)
    sync(path.parent)


def place_folder(partial: Path, path: Path) -> None:
    """As `place`, for a folder whose files are on disk."""
    partial.rename(path)
    sync(path.parent)


def sync(path: Path) -> None:
    """The content written to a file or folder is on disk when this returns."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
