"""The columns of traces as stored in their files, for all file formats; not converted to SI."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from service.errors import BadInput
from service.store.files.columns import CsvForm, read_table
from service.traces.containers.reading import read_containers
from service.traces.containers.request import GROUPED, SUFFIXES, Channel, Taken
from service.traces.mapping import Column, Mapping, TraceSweep

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Raw:
    """By column of the mapping: values (n,), and the unit in the file. `clock` (n,), s: the clock in the file."""

    columns: dict[str, Array]
    units: dict[str, str] = field(default_factory=dict[str, str])
    clock: Array | None = None


def read_raw(mapping: Mapping, traces: Sequence[tuple[Path, TraceSweep]]) -> Iterator[Raw]:
    """One per trace, in order. A separate process reads a MATLAB, MDF4 or HDF5 file once for all of its sweeps.

    BadInput names the file and the column.
    """
    wanted = mapping.columns.sources
    opened: dict[Path, Iterator[Taken]] = {}
    for path, entry in traces:
        if path.suffix.lower() not in GROUPED:
            _refuse_groups(wanted, entry, path)
        if path.suffix.lower() in SUFFIXES:
            if path not in opened:
                sweeps = [_channels(wanted, one) for other, one in traces if other == path]
                opened[path] = iter(read_containers(path, sweeps))
            taken = next(opened[path])
            units = dict(zip(wanted, taken.units, strict=True))
            yield Raw(dict(zip(wanted, taken.columns, strict=True)), units, taken.clock)
        else:
            yield Raw(_table(wanted, mapping, path))


def _channels(wanted: dict[str, Column], entry: TraceSweep) -> tuple[Channel, ...]:
    return tuple(
        Channel(source=column.source, group=entry.group if column.group is None else column.group)
        for column in wanted.values()
    )


def _refuse_groups(wanted: dict[str, Column], entry: TraceSweep, path: Path) -> None:
    for group in (entry.group, *(column.group for column in wanted.values())):
        if group is not None:
            raise BadInput(str(path), f"has no groups, but the mapping names {group!r}: only MDF4 and HDF5 have groups")


def _table(wanted: dict[str, Column], mapping: Mapping, path: Path) -> dict[str, Array]:
    sources = tuple(dict.fromkeys(column.source for column in wanted.values()))
    raw = read_table(path, str(path), sources, form=CsvForm(**mapping.csv.model_dump()))
    return {name: raw[column.source] for name, column in wanted.items()}
