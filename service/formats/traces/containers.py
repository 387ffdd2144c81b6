"""Traces in files with many channels, units and clocks: MATLAB (`mat`), MDF4 (`mdf4`), HDF5 (`hdf5`), ROS bags (`ros`).

Third-party libraries read them in a separate process with limits of memory and time: the parsers of these formats are
large, and the files are untrusted. The process gets a request file and a folder. It writes one array per sweep into the
folder and returns the units.
"""

import asyncio
import importlib
import struct
import tempfile
import zlib
from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np
from pydantic import BaseModel, ConfigDict

from service import BadInput
from service.model import Array
from service.store.files.isolated_reader import LIMITS, Limits, read_isolated

# exceptions of the libraries for truncated or malicious files; memory and disk errors are not caught
_TORN = (
    ArithmeticError, AssertionError, AttributeError, BufferError, EOFError, LookupError, NameError, RuntimeError,
    SyntaxError, TypeError, ValueError, struct.error, zlib.error,
)  # fmt: skip


class ChannelName(BaseModel):
    """`group`: an MDF4 channel group's name, or its number from 0; for HDF5 a path. None: any with this channel."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    source: str
    group: str | int | None


class ListedChannel(BaseModel):
    """A channel that a file has. `role` and `axis`: column of the bundle and axis, where the format states them."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    name: str
    unit: str = ""
    group: str | int | None = None
    role: str = ""
    axis: str = ""


class Asked(BaseModel):
    """The channels of one file, one tuple per sweep; none: their list is wanted."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    file: str
    sweeps: tuple[tuple[ChannelName, ...], ...]


class TakenUnits(BaseModel):
    """Units of one sweep: one per channel, "" if the file has none. `clocked`: with the channels' own clock, in s."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    units: tuple[str, ...]
    clocked: bool
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Taken:
    """`columns` (channels, n) as requested; `clock` (n,) s, if the file has one; `notes`: what was guessed."""

    columns: Array
    units: tuple[str, ...]
    clock: Array | None
    notes: tuple[str, ...] = ()


def split_source(source: str) -> tuple[str, int | None]:
    """Name and, for ``q[2]``, column, from 0."""
    name, _, index = source.partition("[")
    return (name, int(index[:-1])) if index.endswith("]") and index[:-1].isdigit() else (source, None)


def columns_in(name: str, value: np.ndarray[Any, Any]) -> tuple[str, ...]:
    """Names of the columns of numbers in an array."""
    if value.dtype.kind not in "iuf" or value.size < 2:
        return ()
    if value.size == max(value.shape):
        return (name,)
    return tuple(f"{name}[{k}]" for k in range(min(value.shape))) if value.ndim == 2 else ()


def one_column(value: np.ndarray[Any, Any], source: str, place: str) -> np.ndarray[Any, Any]:
    """The array's column that the source names, (n,); samples run along the longer side of a matrix."""
    column, told = split_source(source)[1], f"is not a column of numbers: {value.dtype} {value.shape}"
    numeric = value.dtype.kind in "iuf"
    if numeric and value.size == max(value.shape, default=0) and column in (None, 0):
        return value.ravel()
    if not numeric or value.ndim != 2:
        raise BadInput(place, told)
    if column is None:
        name = source.partition("[")[0]
        raise BadInput(place, f"{told}; give a column, {name}[0] to {name}[{min(value.shape) - 1}]")
    if column >= min(value.shape):
        raise BadInput(place, f"has columns 0 to {min(value.shape) - 1}, not {column}")
    return value[:, column] if value.shape[0] >= value.shape[1] else value[column]


def taken_of(
    channels: Sequence[ChannelName], values: Sequence[np.ndarray[Any, Any]], units: tuple[str, ...], place: str
) -> Taken:
    """Columns of one length."""
    lengths = {channel.source: len(value) for channel, value in zip(channels, values, strict=True)}
    if len(set(lengths.values())) > 1:
        sizes = ", ".join(f"{name} has {length}" for name, length in lengths.items())
        path, _, kind = place.rpartition(" ")
        raise BadInput(path, f"{kind}s of one sweep differ in length, nothing is resampled: {sizes}")
    return Taken(in_rows(values, len(values), len(values[0]) if values else 0), units, None)


def shown(names: list[str]) -> str:
    """At most twelve of the names, for an error message."""
    more = f" and {len(names) - 12} more" if len(names) > 12 else ""
    return ", ".join(name[:60] for name in names[:12]) + more if names else "none"


def in_rows(columns: Iterable[np.ndarray[Any, Any]], count: int, length: int) -> Array:
    """Columns (length,) as one array (count, length); each may be freed before the next one is read."""
    rows = np.empty((count, length))
    for row, column in zip(rows, columns, strict=True):
        row[:] = column
    return rows


def matlab_object(name: str, kind: str, path: Path) -> BadInput:
    """The refusal of a table, timetable or other object, whose values MATLAB alone can take out."""
    return BadInput(
        f"{path} variable {name!r}",
        f"is an object of MATLAB ({kind}): write its columns as a struct, s = table2struct(timetable2table({name}), "
        "'ToScalar', true); s.Time = seconds(s.Time); save('trace.mat', '-struct', 's')",
    )


def check_numbers(rows: int, columns: int, most: int, place: str) -> None:
    """BadInput if the sizes that the file states exceed the limit."""
    if not 0 <= rows * columns <= most:
        raise BadInput(place, f"holds {rows} values of {columns} channels, limit {most} numbers")


def first_bytes(path: Path, count: int) -> bytes:
    """BadInput if the file cannot be read."""
    try:
        with path.open("rb") as file:
            return file.read(count)
    except FileNotFoundError:
        raise BadInput(str(path), "file does not exist") from None
    except (OSError, ValueError) as error:
        raise BadInput(str(path), f"cannot be read: {getattr(error, 'strerror', None) or error}") from None


def format_of(path: Path) -> str:
    """By content; `text` if it has no mark. BadInput if it cannot be read, or is known to be of another kind."""
    marks = (
        (b"\x89HDF\r\n", "hdf5"), (b"MATLAB 7.3", "hdf5"), (b"MATLAB 5", "mat"), (b"MDF ", "mdf4"),
        (b"UnFinMF", "mdf4"), (b"\x89MCAP", "ros"), (b"SQLite format 3", "ros"), (b"#ROSBAG", "ros"),
        (b"PAR1", "parquet"),
    )  # fmt: skip
    foreign = {
        b"PK\x03\x04": "is a zip file, as Excel writes it: export it as CSV",
        b"\xd0\xcf\x11\xe0": "is a file of Office: export it as CSV",
    }
    by_suffix = {".mat": "mat", ".mf4": "mdf4", ".h5": "hdf5", ".hdf5": "hdf5", ".parquet": "parquet"}
    if path.is_dir():
        if (path / "metadata.yaml").is_file():
            return "ros"
        raise BadInput(str(path), "is a folder, and not one of a ROS bag: it has no metadata.yaml")
    head = first_bytes(path, 1024)
    kind = next((kind for mark, kind in marks if head.startswith(mark)), None)
    if kind is None and b"\x89HDF\r\n" in head[512:520]:
        kind = "hdf5"
    kind = kind or by_suffix.get(path.suffix.lower())
    bare = head.replace(b"\0", b"").lstrip(b"\xef\xbb\xbf\xff\xfe \r\n")
    if kind is None and bare.startswith(b"<") and any(mark in bare for mark in (b"<?xml", b"<traceSession")):
        return "xml"
    for mark, what in foreign.items():
        if kind is None and head.startswith(mark):
            known = "CSV and other text, MATLAB, Parquet, MDF4, HDF5, ROS bags (SQLite, MCAP), XML of a Sinumerik"
            raise BadInput(str(path), f"{what}; read are {known}")
    return kind or "text"


class _Reader(Protocol):
    LIBRARY_ERRORS: tuple[type[Exception], ...]

    def listed(self, path: Path) -> tuple[ListedChannel, ...]: ...

    def read(self, path: Path, sweeps: Sequence[Sequence[ChannelName]]) -> Iterator[Taken]: ...


def read_containers(
    path: Path, sweeps: Sequence[tuple[ChannelName, ...]], limits: Limits = LIMITS
) -> tuple[Taken, ...]:
    """The requested channels of a file, by sweep. BadInput: unreadable, a channel is missing, or above a limit."""
    with tempfile.TemporaryDirectory(prefix="sweepid-trace-") as name:
        folder = Path(name)
        asked = Asked(file=str(path), sweeps=tuple(sweeps))
        (folder / "asked.json").write_text(asked.model_dump_json(), encoding="utf-8")
        answer: list[object] = asyncio.run(read_isolated(take, (folder / "asked.json", folder), str(path), limits))
        found = [TakenUnits.model_validate(units) for units in answer]
        return tuple(_stored(folder, number, units) for number, units in enumerate(found))


def list_containers(path: Path, limits: Limits = LIMITS) -> tuple[ListedChannel, ...]:
    """The channels of a file."""
    answer: list[object] = asyncio.run(read_isolated(list_here, (path,), str(path), limits))
    return tuple(ListedChannel.model_validate(one) for one in answer)


def list_here(path: Path) -> list[object]:
    """In the process: the channels."""
    reader = _reader(path)
    with _library_errors(reader, path):
        return [one.model_dump(mode="json") for one in reader.listed(path)]


def take(asked: Path, folder: Path) -> list[object]:
    """In the process: write ``N.npy`` for each sweep, rows as requested, clock last; return their `Units`."""
    wanted = Asked.model_validate_json(asked.read_bytes())
    answer: list[object] = []
    for number, taken in enumerate(read_here(Path(wanted.file), wanted.sweeps)):
        rows = taken.columns if taken.clock is None else np.vstack([taken.columns, taken.clock])
        np.save(folder / f"{number}.npy", rows, allow_pickle=False)
        units = TakenUnits(units=taken.units, clocked=taken.clock is not None, notes=taken.notes)
        answer.append(units.model_dump(mode="json"))
    return answer


def read_here(path: Path, sweeps: Sequence[Sequence[ChannelName]]) -> Iterator[Taken]:
    """The same in this process, one sweep after the other."""
    reader = _reader(path)
    with _library_errors(reader, path):
        yield from reader.read(path, sweeps)


def _reader(path: Path) -> _Reader:
    room = format_of(path)
    try:
        return cast(_Reader, importlib.import_module(f"service.formats.traces.{room}"))
    except ModuleNotFoundError as error:
        raise BadInput(str(path), f"needs {error.name}: install sweepid with its extra, `sweepid[{room}]`") from None


@contextmanager
def _library_errors(reader: _Reader, path: Path) -> Generator[None]:
    try:
        yield
    except (*_TORN, OSError, *reader.LIBRARY_ERRORS) as error:
        reason = " ".join(str(error).split())[:300]
        library = {"mat": "SciPy", "mdf4": "asammdf", "hdf5": "h5py", "ros": "rosbags"}[format_of(path)]
        raise BadInput(str(path), f"cannot be read by {library}: {reason or type(error).__name__}") from None


def _stored(folder: Path, number: int, units: TakenUnits) -> Taken:
    rows = cast(Array, np.load(folder / f"{number}.npy", allow_pickle=False))
    values, clock = (rows[:-1], rows[-1]) if units.clocked else (rows, None)
    return Taken(values, units.units, clock, units.notes)
