"""Channels of an ASAM MDF file of version 4, or of version 3, which is converted first. Needs `sweepid[mdf4]`.

Only identity and linear conversions are applied; formulas in a file are not evaluated. Samples that the file marks as
invalid become NaN, which a bundle does not accept. Channels of groups with different clocks are rejected.
"""

from collections.abc import Iterator, Sequence
from contextlib import closing, suppress
from pathlib import Path
from typing import Any, cast

import numpy as np
import zstd
from asammdf import MDF
from asammdf.blocks import v4_constants
from asammdf.blocks.mdf_v4 import MDF4
from asammdf.blocks.utils import MdfException
from numpy.typing import NDArray

from service import BadInput
from service.formats.traces.containers import ChannelName, ListedChannel, Taken, check_numbers, shown
from service.formats.traces.units import to_si
from service.model import Array, Mask
from service.store.files.columns import MOST_NUMBERS

try:
    from isal.isal_zlib import error as PackedError
except ModuleNotFoundError:  # asammdf imports zlib there
    from zlib import error as PackedError

_OPENED: Any = {"process_bus_logging": False, "original_name": None, "__internal__": True}
LIBRARY_ERRORS: tuple[type[Exception], ...] = (
    MdfException,
    cast("type[Exception]", PackedError),
    cast("type[Exception]", zstd.Error),
)
_MASTERS = (v4_constants.CHANNEL_TYPE_MASTER, v4_constants.CHANNEL_TYPE_VIRTUAL_MASTER)


class _Mdf4(MDF4):
    """If asammdf cannot read a file, the object that it creates prints an error to stderr when it is deleted."""

    def __del__(self) -> None:
        with suppress(AttributeError):
            self.close()


def read(path: Path, sweeps: Sequence[Sequence[ChannelName]]) -> Iterator[Taken]:
    """The channels, one sweep after the other, with the clock of their group."""
    with closing(_opened(path)) as file:
        for channels in sweeps:
            yield _sweep(file, channels, str(path))


def listed(path: Path) -> tuple[ListedChannel, ...]:
    """The channels but for the clocks."""
    with closing(_opened(path)) as file:
        groups = cast("list[Any]", file.groups)
        return tuple(
            ListedChannel(name=str(channel.name), unit=_unit(file, (k, number)), group=k)
            for k, group in enumerate(groups)
            for number, channel in enumerate(group.channels)
            if channel.channel_type not in _MASTERS
        )


def _opened(path: Path) -> Any:
    """Rejects unfinished files, which asammdf would repair in a copy."""
    with path.open("rb") as file:
        head = file.read(64)
    if not head.startswith(b"MDF     ") or len(head) < 64 or any(head[60:64]):
        raise BadInput(
            str(path), f"is not a finalised MDF file: it begins with {head[:8]!r}, flags {head[60:64].hex()}"
        )
    version = min(int.from_bytes(head[28:30], order) for order in ("little", "big"))  # version 3 has both
    if 300 <= version < 400:
        with closing(MDF(str(path))) as old:
            return old.convert("4.10")
    if not 400 <= version < 500:
        raise BadInput(str(path), f"is an MDF file of version {version / 100:.2f}; versions 3 and 4 are read")
    return _Mdf4(str(path), **_OPENED)


def _sweep(file: Any, channels: Sequence[ChannelName], path: str) -> Taken:
    found = [_find(file, channel, path) for channel in channels]
    groups = list(dict.fromkeys(group for group, _ in found))
    rows = max(_records(file, group) for group in groups)
    check_numbers(rows, len(found) + len(groups), MOST_NUMBERS, path)
    clock = _common_clock(file, groups, path)
    columns = [_values(file, place, path) for place in found]
    return Taken(np.array(columns), tuple(_unit(file, place) for place in found), clock)


def _find(file: Any, channel: ChannelName, path: str) -> tuple[int, int]:
    """Number of group and channel; BadInput unless there is exactly one."""
    place = f"{path} channel {channel.source}"
    numbered = cast("list[Any]", file.groups)
    groups = [k for k, group in enumerate(numbered) if channel.group in (None, k, group.channel_group.acq_name)]
    if not groups:
        raise BadInput(
            place, f"group {channel.group!r} does not exist; there are {_group_names(file, range(len(numbered)))}"
        )
    found = [
        (group, number)
        for group in groups
        for number, one in enumerate(numbered[group].channels)
        if one.name == channel.source
    ]
    if not found:
        names = [str(one.name) for group in groups for one in numbered[group].channels]
        raise BadInput(place, f"does not exist; there are {shown(names)}")
    if len(found) > 1:
        raise BadInput(
            place, f"occurs {len(found)} times, in groups {_group_names(file, [k for k, _ in found])}: give one of them"
        )
    return found[0]


def _group_names(file: Any, groups: Sequence[int]) -> str:
    return shown([f"{k} {str(file.groups[k].channel_group.acq_name)!r}" for k in groups])


def _records(file: Any, group: int) -> int:
    return int(file.groups[group].channel_group.cycles_nr)


def _common_clock(file: Any, groups: Sequence[int], path: str) -> Array | None:
    """Common clock, s; None if the group has no time. BadInput if there are several and they differ."""
    clocks = [_clock(file, group, path) for group in groups]
    first = clocks[0]
    if all(_same(clock, first) for clock in clocks[1:]):
        return first
    paces = "; ".join(f"{_group_names(file, [k])} has {_pace(clock)}" for k, clock in zip(groups, clocks, strict=True))
    raise BadInput(path, f"channels of one sweep lie in groups with different clocks, nothing is resampled: {paces}")


def _same(one: Array | None, other: Array | None) -> bool:
    return one is not None and other is not None and np.array_equal(one, other)


def _pace(clock: Array | None) -> str:
    if clock is None or len(clock) < 2:
        return "no clock" if clock is None else f"{len(clock)} samples"
    rate = (len(clock) - 1) / (clock[-1] - clock[0]) if clock[-1] > clock[0] else float("nan")
    return f"{len(clock)} samples from {clock[0]:.6g} s on at {rate:.6g} Hz"


def _clock(file: Any, group: int, path: str) -> Array | None:
    for number, channel in enumerate(file.groups[group].channels):
        if channel.channel_type in _MASTERS and channel.sync_type == 1:  # sync type of a master channel in seconds
            unit = _unit(file, (group, number)) or "s"
            factor, _ = to_si("time", unit, False, f"{path} clock of group {_group_names(file, [group])}")
            return factor * _values(file, (group, number), path)
    return None


def _unit(file: Any, place: tuple[int, int]) -> str:
    channel = file.groups[place[0]].channels[place[1]]
    unit = (channel.conversion and channel.conversion.unit) or channel.unit or ""
    return str(unit).strip()[:60]


def _values(file: Any, place: tuple[int, int], path: str) -> Array:
    """Physical values (n,) of a channel."""
    group, number = place
    channel = file.groups[group].channels[number]
    here = f"{path} channel {channel.name}"
    factor, offset = _conversion(channel.conversion, here)
    raw, invalid = cast(
        "tuple[NDArray[Any], Mask | None]",
        file.get(group=group, index=number, raw=True, samples_only=True, ignore_invalidation_bits=True),
    )
    if raw.ndim != 1 or raw.dtype.kind not in "iuf":
        raise BadInput(here, f"is not a column of numbers: {raw.dtype} {raw.shape}")
    if len(raw) != _records(file, group):
        raise BadInput(here, f"has {len(raw)} of {_records(file, group)} values: the file is incomplete")
    values = factor * raw.astype(np.float64) + offset
    if invalid is not None:
        values[np.asarray(invalid, bool)] = np.nan
    return values


def _conversion(conversion: Any, place: str) -> tuple[float, float]:
    if conversion is None or conversion.conversion_type == v4_constants.CONVERSION_TYPE_NON:
        return 1.0, 0.0
    kind = int(conversion.conversion_type)
    if kind == v4_constants.CONVERSION_TYPE_LIN:
        return float(conversion.a), float(conversion.b)
    if (
        kind == v4_constants.CONVERSION_TYPE_RAT
        and not (conversion.P1 or conversion.P4 or conversion.P5)
        and conversion.P6
    ):
        return float(conversion.P2 / conversion.P6), float(conversion.P3 / conversion.P6)
    named = v4_constants.CONVERSION_TYPE_TO_STRING.get(kind, str(kind))
    raise BadInput(place, f"has the conversion {named}; only none and linear (also as rational) can be read")
