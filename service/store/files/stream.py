"""Samples as a stream of Arrow IPC: after any failure, all blocks on disk can be read back."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from service.model.errors import SweepidError

Array = NDArray[np.float64]
Column = Array | NDArray[np.int64]

# pyarrow has no type stubs: its objects are untyped here, and returned values are narrowed
_arrow = cast(Any, pa)
# errors of Arrow for a page that a power failure left zeroed or incomplete
_TORN = (_arrow.ArrowException, OSError, ValueError, TypeError, MemoryError)


class UnreadableStream(SweepidError):
    """The stream contains no recording: its head is damaged, not only its end."""


class SampleStream:
    """A new file of blocks. Methods block until the data is on disk. Raises OSError if it cannot be written."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("xb")
        self._writer: Any = None
        # Arrow's first conversion imports pandas if it is installed: up to a second in which the thread that
        # streams set-points is delayed. Do it before any motion.
        _arrow.array(np.empty(0))

    def write(self, columns: Mapping[str, Column]) -> None:
        """Append a block of columns (n,), always the same ones."""
        batch = _arrow.RecordBatch.from_pydict(dict(columns))
        if self._writer is None:
            self._writer = _arrow.ipc.new_stream(self._file, batch.schema)
        self._writer.write_batch(batch)
        self._file.flush()
        os.fsync(self._file.fileno())

    def close(self) -> None:
        """Close the file, without an end mark: a truncated stream is also readable, and a full disk cannot store
        one.
        """
        self._file.close()


def read_blocks(path: Path) -> dict[str, Array] | None:
    """The columns (n,) of a stream up to its truncated end; None with fewer than two samples.

    Raises UnreadableStream if the content is not columns.
    """
    batches: list[Any] = []
    with path.open("rb") as file:
        try:
            reader = _arrow.ipc.open_stream(file)
            while True:
                batch = reader.read_next_batch()
                batch.validate(full=True)  # otherwise Arrow trusts the lengths in a damaged batch and crashes
                batches.append(batch)
        except StopIteration:
            pass
        except _TORN:
            pass  # the truncated end: expected after a crash; everything before it is complete
    if sum(len(batch) for batch in batches) < 2:
        return None
    try:
        table = _arrow.Table.from_batches(batches)
        return {name: np.array(table.column(name).to_numpy()) for name in table.column_names if name != "index"}
    except (*_TORN, LookupError) as error:
        raise damaged(path, error) from error


def damaged(path: Path, error: Exception) -> UnreadableStream:
    """Error with a description."""
    return UnreadableStream(f"{path.name} is damaged: {type(error).__name__}: {error}")
