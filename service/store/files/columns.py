"""The samples of one sweep as a file: Parquet or CSV with the columns of BUNDLE.md. The only room that knows pyarrow's
readers; all numbers come and go as float64.
"""

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pa_parquet
from numpy.typing import NDArray

from service.errors import BadInput
from service.recording import OPTIONAL_COLUMNS, REQUIRED_COLUMNS, Recording

Array = NDArray[np.float64]

# pyarrow ships without types: its modules are opaque here and every value is narrowed on the way out
_arrow, _csv, _parquet = cast(Any, pa), cast(Any, pa_csv), cast(Any, pa_parquet)


MOST_NUMBERS = 50_000_000  # of one file: an hour of all columns at 1 kHz and more
LARGEST_CSV = 2**29  # bytes


@dataclass(frozen=True, slots=True)
class CsvForm:
    """How a CSV file is written: BUNDLE.md knows the plain form only, trace exports come in others."""

    delimiter: str = ","
    decimal_point: str = "."
    skip_rows: int = 0  # lines before the line of column names


PLAIN = CsvForm()


def read_columns(path: Path, place: str | None = None) -> Recording:
    """One sweep's samples. Columns that BUNDLE.md does not know are left out.

    BadInput (at `place`, default the path) for a file that cannot be read, a missing or doubled column, a value that
    is no finite number, fewer than two samples, or a `time` that does not start at 0 or does not increase.
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
        raise BadInput(str(path), "samples are .parquet or .csv")


def check_samples(recording: Recording, place: str) -> None:
    """BadInput unless all columns are equally long and finite, and `time` starts at 0 and increases strictly."""
    count = recording.time.size
    if count < 2:
        raise BadInput(place, f"has {count} samples; a sweep has two at least")
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


def read_table(
    path: Path, place: str, required: Collection[str], optional: Collection[str] = (), form: CsvForm = PLAIN
) -> dict[str, Array]:
    """The named columns of a Parquet or CSV file by name, each (n,); what is empty is NaN.

    BadInput (at `place`) for a file that cannot be read, a required column that is missing, a column that stands
    twice, or text where a number is due.
    """
    if path.suffix not in (".csv", ".parquet"):
        raise BadInput(place, "samples are .parquet or .csv")
    try:
        wanted = {*required, *optional}
        table = _read_csv(path, form, place) if path.suffix == ".csv" else _read_parquet(path, wanted, place)
        there = cast(list[str], table.column_names)
        for name in required:
            if name not in there:
                raise BadInput(place, f"column {name!r} is missing; there are {', '.join(there) or 'none'}")
        return {name: _numbers(table, name, place) for name in (*required, *optional) if name in there}
    except FileNotFoundError:
        raise BadInput(place, "file does not exist") from None
    except MemoryError:  # Arrow's is an ArrowException too
        raise
    except (OSError, ValueError, _arrow.ArrowException) as error:
        raise BadInput(place, f"cannot be read: {' '.join(str(error).split())}") from None


def columns_of(recording: Recording) -> dict[str, Array]:
    """The columns that a recording has, by name."""
    columns = {name: cast(Array | None, getattr(recording, name)) for name in (*REQUIRED_COLUMNS, *OPTIONAL_COLUMNS)}
    return {name: column for name, column in columns.items() if column is not None}


def _read_parquet(path: Path, wanted: Collection[str], place: str) -> Any:
    """The wanted columns. What the file says of itself is looked at before: a small file can hold very long columns."""
    with _parquet.ParquetFile(str(path)) as file:
        schema, metadata = file.schema_arrow, file.metadata
        names = cast(list[str], schema.names)
        rows = max(int(metadata.num_rows), sum(metadata.row_group(k).num_rows for k in range(metadata.num_row_groups)))
        _check_numbers(rows, sum(name in wanted for name in names), place)
        for name in names:
            if name in wanted:
                if names.count(name) > 1:
                    raise BadInput(place, f"column {name!r} occurs twice")
                _check_type(schema.field(name).type, name, place)
        present = [name for name in names if name in wanted]
        return file.read(columns=present) if present else schema.empty_table()


def _check_numbers(rows: int, columns: int, place: str) -> None:
    if rows * columns > MOST_NUMBERS:
        raise BadInput(place, f"holds {rows} rows of {columns} columns, limit {MOST_NUMBERS} numbers")


def _check_type(kind: Any, name: str, place: str) -> None:
    kinds = _arrow.types
    if not (kinds.is_integer(kind) or kinds.is_floating(kind) or kinds.is_null(kind)):
        raise BadInput(place, f"column {name!r} holds {kind}, not numbers")


def _read_csv(path: Path, form: CsvForm, place: str) -> Any:
    size = path.stat().st_size
    if size > LARGEST_CSV:
        raise BadInput(place, f"is {size} bytes large, limit {LARGEST_CSV} bytes")
    return _csv.read_csv(
        str(path),
        read_options=_csv.ReadOptions(skip_rows=form.skip_rows),
        parse_options=_csv.ParseOptions(delimiter=form.delimiter),
        convert_options=_csv.ConvertOptions(decimal_point=form.decimal_point),
    )


def _numbers(table: Any, name: str, place: str) -> Array:
    if table.column_names.count(name) > 1:
        raise BadInput(place, f"column {name!r} occurs twice")
    column = table.column(name)
    _check_type(column.type, name, place)
    return np.array(column.cast(_arrow.float64(), safe=False).to_numpy(), dtype=np.float64)
