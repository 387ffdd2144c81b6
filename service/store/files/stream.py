"""Samples as a stream of Arrow IPC: whatever happens, all blocks that the disk has taken can be read back."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from service.errors import SweepidError

Array = NDArray[np.float64]
Column = Array | NDArray[np.int64]

# pyarrow ships without types: what it makes is opaque here and narrowed on the way out
_arrow = cast(Any, pa)
# what Arrow makes of a page that a power cut left zeroed or half-written
_TORN = (_arrow.ArrowException, OSError, ValueError, TypeError, MemoryError)


class UnreadableStream(SweepidError):
    """What is left of a stream makes no recording: its head is damaged, not only its end."""


class SampleStream:
    """A new file of blocks. Methods block until the disk has it; OSError when the disk does not take it."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("xb")
        self._writer: Any = None
        # Arrow's first conversion imports pandas where that is installed: up to a second in which the thread that
        # streams set-points is held up. Do it before anything moves.
        _arrow.array(np.empty(0))

    def write(self, columns: Mapping[str, Column]) -> None:
        """Append a block of columns (n,), always the same."""
        batch = _arrow.RecordBatch.from_pydict(dict(columns))
        if self._writer is None:
            self._writer = _arrow.ipc.new_stream(self._file, batch.schema)
        self._writer.write_batch(batch)
        self._file.flush()
        os.fsync(self._file.fileno())

    def close(self) -> None:
        """Close the file. Without an end mark: a stream that is cut off is as readable, and a full disk takes none."""
        self._file.close()


def read_blocks(path: Path) -> dict[str, Array] | None:
    """The columns (n,) that a stream holds up to its torn end; None with fewer than two samples.

    UnreadableStream where what it holds are no columns.
    """
    batches: list[Any] = []
    with path.open("rb") as file:
        try:
            reader = _arrow.ipc.open_stream(file)
            while True:
                batch = reader.read_next_batch()
                batch.validate(full=True)  # Arrow believes lengths that a damaged batch tells, and dies of them
                batches.append(batch)
        except StopIteration:
            pass
        except _TORN:
            pass  # the torn end: expected after a crash, and everything before it is whole
    if sum(len(batch) for batch in batches) < 2:
        return None
    try:
        table = _arrow.Table.from_batches(batches)
        return {name: np.array(table.column(name).to_numpy()) for name in table.column_names if name != "index"}
    except (*_TORN, LookupError) as error:
        raise damaged(path, error) from error


def damaged(path: Path, error: Exception) -> UnreadableStream:
    """In words."""
    return UnreadableStream(f"{path.name} is damaged: {type(error).__name__}: {error}")
