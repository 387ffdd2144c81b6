"""The samples of one sweep as a file: Parquet or CSV with the columns of docs/reference/bundle.md. The only user of
pyarrow's readers; all numbers are float64.
"""

import os
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pa_parquet
from numpy.typing import NDArray

from service import BadInput, SweepidError
from service.model import OPTIONAL_COLUMNS, REQUIRED_COLUMNS, Array, Recording
from service.model.physical_bounds import most_of_column

# pyarrow has no type stubs: its modules are untyped here, and every returned value is narrowed
_arrow, _csv, _parquet = cast(Any, pa), cast(Any, pa_csv), cast(Any, pa_parquet)


MOST_NUMBERS = 50_000_000  # per file: more than an hour of all columns at 1 kHz
LARGEST_CSV = 2**29  # bytes


def read_columns(path: Path, place: str | None = None) -> Recording:
    """One sweep's samples. Columns that are not part of the bundle format are ignored.

    Raises BadInput (at `place`, default the path) for a file that cannot be read, a missing or duplicate column, a
    value that is not a finite number, fewer than two samples, or a `time` that does not start at 0 or does not
    increase.
    """
    place = place or str(path)
    columns = read_table(path, place, REQUIRED_COLUMNS, OPTIONAL_COLUMNS)
    recording = Recording(**columns)
    check_samples(recording, place)
    return recording


def write_columns(path: Path, recording: Recording) -> None:
    """Write a sweep's samples as Parquet or CSV, by the suffix; optional columns that are None are left out."""
    check_samples(recording, str(path))
    table = _arrow.table(columns_of(recording))
    if path.suffix == ".csv":
        _csv.write_csv(table, str(path), _csv.WriteOptions(quoting_style="none"))
    elif path.suffix == ".parquet":
        _parquet.write_table(table, str(path))
    else:
        raise BadInput(str(path), "a file of samples must be .parquet or .csv")


def check_samples(recording: Recording, place: str) -> None:
    """Raises BadInput unless all columns are equally long and finite, and `time` starts at 0 and increases strictly."""
    count = recording.time.size
    if count < 2:
        raise BadInput(place, f"has {count} samples; limit at least 2")
    for name, column in columns_of(recording).items():
        if column.shape != (count,):
            raise BadInput(place, f"column {name!r} has shape {column.shape}, time has ({count},)")
        bad = np.flatnonzero(~np.isfinite(column))
        if bad.size:
            raise BadInput(place, f"column {name!r} is {column[bad[0]]} in row {bad[0] + 1}")
    steps = np.diff(recording.time)
    back = np.flatnonzero(steps <= 0)
    if back.size:
        row = int(back[0]) + 1
        before, after = recording.time[row - 1], recording.time[row]
        raise BadInput(place, f"time does not increase at row {row + 1}: {after} s after {before} s")
    if abs(recording.time[0]) >= steps[0]:
        raise BadInput(place, f"time starts at {recording.time[0]} s; it must start at 0")


def check_possible(recording: Recording, place: str) -> None:
    """Raises BadInput for a sample that is beyond any machine."""
    for name, column in columns_of(recording).items():
        beyond = np.flatnonzero(np.abs(column) > most_of_column(name))
        if beyond.size:
            value, row = column[beyond[0]], beyond[0] + 1
            raise BadInput(place, f"column {name!r} is {value:g} in row {row}; limit {most_of_column(name):g}")


def read_table(path: Path, place: str, required: Collection[str], optional: Collection[str] = ()) -> dict[str, Array]:
    """The named columns of a Parquet or CSV file by name, each (n,); empty values are NaN.

    Raises BadInput (at `place`) for a file that cannot be read, a missing required column, a duplicate column, or
    text instead of a number.
    """
    suffix = path.suffix.lower()
    if suffix not in (".csv", ".parquet"):
        raise BadInput(place, "a file of samples must be .parquet or .csv")
    wanted = tuple(dict.fromkeys((*required, *optional)))
    try:
        if suffix == ".csv":
            return _read_csv(path, required, wanted, place)
        return _read_parquet(path, required, wanted, place)
    except FileNotFoundError:
        raise BadInput(place, "file does not exist") from None
    except MemoryError:  # that of Arrow is also an ArrowException
        raise
    except (OSError, ValueError, _arrow.ArrowException) as error:
        raise BadInput(place, f"cannot be read: {' '.join(str(error).split())}") from None


def table_names(path: Path) -> tuple[str, ...]:
    """Names of the columns of a Parquet file; BadInput if it cannot be read."""
    try:
        return tuple(map(str, _parquet.read_schema(str(path)).names))
    except (OSError, ValueError, _arrow.ArrowException) as error:
        raise BadInput(str(path), f"cannot be read: {' '.join(str(error).split())}") from None


def columns_of(recording: Recording) -> dict[str, Array]:
    """The columns of a recording, by name."""
    columns = {name: cast(Array | None, getattr(recording, name)) for name in (*REQUIRED_COLUMNS, *OPTIONAL_COLUMNS)}
    return {name: column for name, column in columns.items() if column is not None}


def _read_parquet(path: Path, required: Collection[str], wanted: Sequence[str], place: str) -> dict[str, Array]:
    """The wanted columns. The metadata of the file is checked first: a small file can contain very long columns.

    One column is read at a time, so that no more than one is in memory twice.
    """
    with _parquet.ParquetFile(str(path)) as file:
        schema, metadata = file.schema_arrow, file.metadata
        names = cast(list[str], schema.names)
        rows = max(int(metadata.num_rows), sum(metadata.row_group(k).num_rows for k in range(metadata.num_row_groups)))
        _check_numbers(rows, sum(name in wanted for name in names), place)
        present = _present(names, required, wanted, place)
        for name in present:
            _check_type(schema.field(name).type, name, place)
        return {name: _numbers(file.read(columns=[name]).column(0)) for name in present}


def _present(names: list[str], required: Collection[str], wanted: Sequence[str], place: str) -> list[str]:
    """Of the wanted columns those that the file has. BadInput where one occurs twice or a required one is missing."""
    for name in required:
        if name not in names:
            raise BadInput(place, f"column {name!r} is missing; there are {_shown(names)}")
    present = [name for name in wanted if name in names]
    for name in present:
        if names.count(name) > 1:
            raise BadInput(place, f"column {name!r} occurs twice")
    return present


def _check_numbers(rows: int, columns: int, place: str) -> None:
    if rows * columns > MOST_NUMBERS:
        raise BadInput(place, f"holds {rows} rows of {columns} columns, limit {MOST_NUMBERS} numbers")


def _check_type(kind: Any, name: str, place: str) -> None:
    kinds = _arrow.types
    if not (kinds.is_integer(kind) or kinds.is_floating(kind) or kinds.is_null(kind)):
        raise BadInput(place, f"column {name!r} holds {kind}, not numbers")


def _shown(names: list[str], most: int = 20) -> str:
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(name[:60] for name in names[:most]) + more if names else "none"


def _read_csv(path: Path, required: Collection[str], wanted: Sequence[str], place: str) -> dict[str, Array]:
    """The wanted columns. Lines are counted before anything is parsed.

    The file is read block by block into the columns, so that no more than a block is in memory twice.
    """
    size = path.stat().st_size
    if size > LARGEST_CSV:
        raise BadInput(place, f"is {size} bytes large, limit {LARGEST_CSV} bytes")
    how = {"read_options": _csv.ReadOptions(use_threads=False)}  # errors then name the row
    with _csv.open_csv(_arrow.py_buffer(_first_lines(path)), **how) as file:  # a path is read ahead
        names = cast(list[str], file.schema.names)
    present = _present(names, required, wanted, place)
    lines = _lines(path)
    _check_numbers(lines, len(present), place)
    options = _csv.ConvertOptions(include_columns=present)
    with _csv.open_csv(str(path), convert_options=options, **how) as file:
        for name in present:
            _check_type(file.schema.field(name).type, name, place)
    options.column_types = dict.fromkeys(present, _arrow.float64())  # not by the first block: 1 may be followed by 1.5
    columns, rows = {name: np.empty(lines) for name in present}, 0
    with _csv.open_csv(str(path), convert_options=options, **how) as file:
        for batch in file:
            end = rows + int(batch.num_rows)
            for name, column in columns.items():
                column[rows:end] = _numbers(batch.column(name))
            rows = end
    return {name: column[:rows] for name, column in columns.items()}


def _first_lines(path: Path) -> bytes:
    """The lines of the first block that pyarrow would read (1 MiB), without a last one that is cut off."""
    with path.open("rb") as file:
        block = file.read(2**20)
    end = max(block.rfind(b"\n"), block.rfind(b"\r")) + 1
    return block[:end] if end and len(block) == 2**20 else block


def _lines(path: Path) -> int:
    """At most so many lines, whatever ends them: CR, LF, CR LF, or each of them somewhere."""
    count = 1
    with path.open("rb") as file:
        while part := file.read(2**20):  # a CR LF in two parts counts twice
            count += part.count(b"\n") + part.count(b"\r") - part.count(b"\r\n")
    return count


def _numbers(column: Any) -> Array:
    """An own copy, (n,)."""
    return np.array(column.cast(_arrow.float64(), safe=False).to_numpy(zero_copy_only=False), dtype=np.float64)


Column = Array | NDArray[np.int64]

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
        """Close without an end mark: a truncated stream is readable, and a full disk cannot store one."""
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
