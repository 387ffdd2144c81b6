"""The columns of traces as stored in their files, for all file formats; not converted to SI."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from service import BadInput
from service.formats.traces.containers import (
    ChannelName,
    ListedChannel,
    Taken,
    format_of,
    list_containers,
    read_containers,
)
from service.formats.traces.line_trace import LineTrace
from service.formats.traces.mapping import Columns, Csv, FromPosition, Mapping, SourceColumn, TraceSweep
from service.formats.traces.tables import TextTable
from service.formats.traces.units import find_roles
from service.model import Array
from service.store.files.columns import read_table, table_names

GROUPED = ("mdf4", "hdf5", "ros", "xml")


@dataclass(frozen=True, slots=True)
class Raw:
    """By column of the mapping: where it is, values (n,), and the unit in the file. `clock` (n,), s: the clock in the
    file. `found`: columns that the mapping does not name. `velocity`: the measured one, or how it is derived.
    """

    columns: dict[str, Array]
    sources: dict[str, SourceColumn]
    units: dict[str, str] = field(default_factory=dict[str, str])
    clock: Array | None = None
    found: frozenset[str] = frozenset()
    notes: tuple[str, ...] = ()


class _TraceFile:
    """One trace file, opened once for all of its sweeps."""

    def __init__(self, path: Path, form: Csv) -> None:
        self.path, self.kind = path, format_of(path)
        self._text = TextTable(path, form) if self.kind == "text" else None
        self._xml = LineTrace(path) if self.kind == "xml" else None

    @cached_property
    def listed(self) -> tuple[ListedChannel, ...]:
        given = self._text or self._xml
        if given is not None:
            return given.listed
        if self.kind == "parquet":
            return tuple(ListedChannel(name=name) for name in table_names(self.path))
        return list_containers(self.path)

    def read(self, sweeps: Sequence[tuple[ChannelName, ...]]) -> Iterator[Taken]:
        given = self._text or self._xml
        if given is not None:
            return (given.read(channels) for channels in sweeps)
        if self.kind == "parquet":
            return (self._parquet(channels) for channels in sweeps)
        return iter(read_containers(self.path, sweeps))

    def _parquet(self, channels: tuple[ChannelName, ...]) -> Taken:
        names = tuple(dict.fromkeys(channel.source for channel in channels))
        table = read_table(self.path, str(self.path), names)
        return Taken(np.array([table[channel.source] for channel in channels]), ("",) * len(channels), None)


def sessions_of(path: Path) -> int:
    """How many recordings the trace of a control holds; 1 for other files."""
    return len(LineTrace(path).sessions) if format_of(path) == "xml" else 1


def read_raw(mapping: Mapping, traces: Sequence[tuple[Path, TraceSweep]]) -> Iterator[Raw]:
    """One per trace, in order. A separate process reads a MATLAB, MDF4, HDF5 or ROS file once for all of its sweeps.

    BadInput names the file and the column.
    """
    files: dict[Path, _TraceFile] = {}
    plans: list[tuple[Path, dict[str, SourceColumn], dict[str, str]]] = []
    for path, entry in traces:
        file = files[path] = files.get(path) or _TraceFile(path, mapping.csv)
        groups = (entry.group, *(column.group for column in mapping.columns.sources.values()))
        if file.kind not in GROUPED and (named := [group for group in groups if group is not None]):
            told = (
                f"has no groups, but the mapping names {named[0]!r}: only MDF4, HDF5, ROS bags and a control's XML have"
            )
            raise BadInput(str(path), told)
        wanted, found = _sources(mapping.columns, entry, file)
        plans.append((path, wanted, found))
    asked = [(path, _channels(wanted, entry)) for (path, wanted, _), (_, entry) in zip(plans, traces, strict=True)]
    opened = {path: file.read([names for at, names in asked if at == path]) for path, file in files.items()}
    for path, wanted, found in plans:
        taken = next(opened[path])
        units = {name: unit or found.get(name, "") for name, unit in zip(wanted, taken.units, strict=True)}
        columns = dict(zip(wanted, taken.columns, strict=True))
        yield Raw(columns, wanted, units, taken.clock, frozenset(found), taken.notes)


def _sources(columns: Columns, entry: TraceSweep, file: _TraceFile) -> tuple[dict[str, SourceColumn], dict[str, str]]:
    """Columns that the mapping names with those that are found in the file, and the units of these by their role."""
    named = columns.sources
    derived, needed = isinstance(columns.velocity, FromPosition), ("effort", "position")
    if all(name in named for name in needed) and (derived or "velocity" in named):
        return named, {}
    listed = [one for one in file.listed if entry.group is None or one.group in (entry.group, None)]
    if entry.group is None and file.kind == "xml":
        listed = [one for one in listed if one.group == 1]
    axis = "" if entry.file_axis is None else str(entry.file_axis)
    axis = axis or next((one.axis for one in listed if one.axis == entry.axis), "")
    roles = find_roles(listed, axis, str(file.path))
    units = {} if "effort" in roles or "current" not in roles else {"effort": "A"}
    if units:
        roles["effort"] = roles["current"]
    if "position" not in roles and "load_position" in roles:
        roles["position"] = roles.pop("load_position")
    wanted = {
        name: SourceColumn(source=one.name, group=one.group if file.kind in GROUPED else None)
        for name, one in roles.items()
        if name in Columns.model_fields and name not in named and not (name == "velocity" and derived)
    }
    whole = {**named, **wanted}
    missing = [name for name in needed if name not in whole]
    if missing:
        there = ", ".join(f"{one.name} [{one.unit}]" if one.unit else one.name for one in file.listed[:12])
        told = f"has no channel that is known as {' or '.join(missing)}; there are {there}: name it in a mapping"
        raise BadInput(str(file.path), told)
    ordered = {name: whole[name] for name in Columns.model_fields if name in whole}
    return ordered, {name: units.get(name, "") for name in wanted}


def _channels(wanted: dict[str, SourceColumn], entry: TraceSweep) -> tuple[ChannelName, ...]:
    return tuple(
        ChannelName(source=column.name, group=entry.group if column.group is None else column.group)
        for column in wanted.values()
    )
