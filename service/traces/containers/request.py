"""Request to the trace reader, and its answer."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from service.errors import BadInput

Array = NDArray[np.float64]

GROUPED = (".mf4", ".h5", ".hdf5")  # formats with channel groups
SUFFIXES = (".mat", *GROUPED)
MOST_SHOWN = 12  # names listed in an error message


class Channel(BaseModel):
    """`group`: an MDF4 channel group's name, or its number from 0; for HDF5 a path. None: any with this channel."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    source: str
    group: str | int | None


class Asked(BaseModel):
    """The channels of one file, one tuple per sweep."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    file: str
    sweeps: tuple[tuple[Channel, ...], ...]


class Units(BaseModel):
    """Units of one sweep: one per channel, "" if the file has none. `clocked`: with the channels' own clock, in s."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    units: tuple[str, ...]
    clocked: bool


@dataclass(frozen=True, slots=True)
class Taken:
    """`columns` (channels, n) as requested; `clock` (n,) s, that of one MDF4 channel group, else None."""

    columns: Array
    units: tuple[str, ...]
    clock: Array | None


def shown(names: list[str]) -> str:
    """Some of the names, for an error message."""
    more = f" and {len(names) - MOST_SHOWN} more" if len(names) > MOST_SHOWN else ""
    return ", ".join(name[:60] for name in names[:MOST_SHOWN]) + more if names else "none"


def in_rows(columns: Iterable[Array], count: int, length: int) -> Array:
    """Columns (length,) as one array (count, length); each may be freed before the next one is read."""
    rows = np.empty((count, length))
    for row, column in zip(rows, columns, strict=True):
        row[:] = column
    return rows


def check_numbers(rows: int, columns: int, most: int, place: str) -> None:
    """BadInput if the sizes that the file states exceed the limit."""
    if not 0 <= rows * columns <= most:
        raise BadInput(place, f"holds {rows} values of {columns} channels, limit {most} numbers")
