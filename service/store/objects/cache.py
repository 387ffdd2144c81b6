"""Local copies of recordings that are in the object store."""

import time
from collections.abc import Callable, Collection
from pathlib import Path

_IN_USE = 60.0  # s after writing or fetching in which no file is removed, because it may be about to be opened


def make_room(data_dir: Path, limit: int, moved: Callable[[], Collection[str]]) -> int:
    """Remove the oldest files of moved recordings until the rest has at most `limit` bytes. Returns how many were
    removed.

    `moved` returns the paths (relative) of recordings in the store; called only if something must be removed.
    """
    here = {path: path.stat() for path in (data_dir / "recordings").glob("*/[!.]*.parquet")}
    if sum(status.st_size for status in here.values()) <= limit:
        return 0
    paths = moved()
    old = time.time() - _IN_USE
    room, removed = limit, 0
    for path, status in sorted(here.items(), key=lambda each: each[1].st_mtime, reverse=True):
        if path.relative_to(data_dir).as_posix() not in paths:
            continue
        if status.st_size <= room or status.st_mtime > old:
            room -= status.st_size
        else:
            path.unlink(missing_ok=True)
            removed += 1
    return removed
