"""Files come to their place whole or not at all."""

import os
from pathlib import Path


def place_new(partial: Path, path: Path) -> None:
    """As `place`, but FileExistsError, and nothing changed, where something is there already."""
    sync(partial)
    try:
        os.link(partial, path)
    except FileExistsError:
        raise
    except OSError:  # a file system without links: the name is taken first
        path.open("xb").close()
        partial.replace(path)
    partial.unlink(missing_ok=True)
    sync(path.parent)


def place(partial: Path, path: Path) -> None:
    """Bring a finished file to its place so that a power cut leaves the whole file or none."""
    sync(partial)
    partial.replace(path)
    sync(path.parent)


def place_folder(partial: Path, path: Path) -> None:
    """As `place`, for a folder whose files are on the disk."""
    partial.rename(path)
    sync(path.parent)


def sync(path: Path) -> None:
    """What was written to a file or folder is on the disk when this returns."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
