"""Request to the trace reader, and its answer."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from service.model.errors import BadInput

Array = NDArray[np.float64]

MOST_SHOWN = 12  # names listed in an error message


class Channel(BaseModel):
    """`group`: an MDF4 channel group's name, or its number from 0; for HDF5 a path. None: any with this channel."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    source: str
    group: str | int | None


class Listed(BaseModel):
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
    sweeps: tuple[tuple[Channel, ...], ...]


class Units(BaseModel):
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
    column = split_source(source)[1]
    if value.dtype.kind not in "iuf":
        raise BadInput(place, f"is not a column of numbers: {value.dtype} {value.shape}")
    if value.size == max(value.shape, default=0) and column in (None, 0):
        return value.ravel()
    if value.ndim != 2:
        raise BadInput(place, f"is not a column of numbers: {value.dtype} {value.shape}")
    if column is None:
        name = source.partition("[")[0]
        raise BadInput(
            place,
            f"is not a column of numbers: {value.dtype} {value.shape}; "
            f"give a column, {name}[0] to {name}[{min(value.shape) - 1}]",
        )
    if column >= min(value.shape):
        raise BadInput(place, f"has columns 0 to {min(value.shape) - 1}, not {column}")
    return value[:, column] if value.shape[0] >= value.shape[1] else value[column]


def taken_of(
    channels: Sequence[Channel], values: Sequence[np.ndarray[Any, Any]], units: tuple[str, ...], place: str
) -> Taken:
    """Columns of one length."""
    lengths = {channel.source: len(value) for channel, value in zip(channels, values, strict=True)}
    if len(set(lengths.values())) > 1:
        sizes = ", ".join(f"{name} has {length}" for name, length in lengths.items())
        raise BadInput(
            place.rpartition(" ")[0],
            f"{place.rpartition(' ')[2]}s of one sweep differ in length, nothing is resampled: {sizes}",
        )
    return Taken(in_rows(values, len(values), len(values[0]) if values else 0), units, None)


def shown(names: list[str]) -> str:
    """Some of the names, for an error message."""
    more = f" and {len(names) - MOST_SHOWN} more" if len(names) > MOST_SHOWN else ""
    return ", ".join(name[:60] for name in names[:MOST_SHOWN]) + more if names else "none"


def in_rows(columns: Iterable[np.ndarray[Any, Any]], count: int, length: int) -> Array:
    """Columns (length,) as one array (count, length); each may be freed before the next one is read."""
    rows = np.empty((count, length))
    for row, column in zip(rows, columns, strict=True):
        row[:] = column
    return rows


def check_numbers(rows: int, columns: int, most: int, place: str) -> None:
    """BadInput if the sizes that the file states exceed the limit."""
    if not 0 <= rows * columns <= most:
        raise BadInput(place, f"holds {rows} values of {columns} channels, limit {most} numbers")
