"""Variables of a MATLAB file of version 4 to 7.2: vectors, columns of matrices, fields of structs (``log.q[0]``)."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat, whosmat
from scipy.io.matlab import MatlabOpaque, MatReadError

from service import BadInput
from service.formats.traces.containers import (
    ChannelName,
    ListedChannel,
    Taken,
    check_numbers,
    columns_in,
    matlab_object,
    one_column,
    shown,
    taken_of,
)
from service.store.files.columns import MOST_NUMBERS

LIBRARY_ERRORS: tuple[type[Exception], ...] = (MatReadError,)


def read(path: Path, sweeps: Sequence[Sequence[ChannelName]]) -> Iterator[Taken]:
    """The variables, one sweep after the other; the file contains neither units nor a clock.

    The shapes in the file header are compared with the limit before values are read.
    """
    stated = _stated(path)
    for channels in sweeps:
        present = sorted({_root(channel.source) for channel in channels} & set(stated))
        content = _load(path, stated, present)
        values = [_value(content, channel.source, stated, path) for channel in channels]
        yield taken_of(channels, values, ("",) * len(channels), f"{path} variable")


def listed(path: Path) -> tuple[ListedChannel, ...]:
    """The columns of numbers."""
    stated = _stated(path)
    content = _load(path, stated, sorted(stated))
    found = [pair for name in stated if name in content for pair in _leaves(name, content[name])]
    return tuple(ListedChannel(name=name) for name, value in found for name in columns_in(name, value))


def _stated(path: Path) -> dict[str, tuple[int, ...]]:
    """Shape by variable. BadInput for a file of objects alone; SciPy lists no file that has one."""
    try:
        return {str(name): shape for name, shape, _ in whosmat(str(path))}
    except TypeError:
        content = loadmat(str(path), struct_as_record=True)
    held: Any = content.pop("None", None)  # objects have no name there
    stated = {name: value.shape for name, value in content.items() if not name.startswith("__")}
    if not stated and isinstance(held, MatlabOpaque):
        raise matlab_object(_plain(held["s0"].ravel()[0]), _plain(held["s2"].ravel()[0]), path)
    return stated


def _plain(value: Any) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def _load(path: Path, stated: dict[str, tuple[int, ...]], names: list[str]) -> dict[str, object]:
    check_numbers(sum(_size(stated[name]) for name in names), 1, MOST_NUMBERS, str(path))
    # a truncated file is rejected here, whatever it lacks
    return loadmat(str(path), variable_names=names, struct_as_record=True)


def _root(source: str) -> str:
    return source.replace("[", ".").partition(".")[0]


def _fields(value: Any) -> tuple[str, ...]:
    array = np.asarray(value)
    return array.dtype.names or () if array.dtype.names and array.size == 1 else ()


def _leaves(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    fields = _fields(value)
    if not fields:
        yield name, np.asarray(value)
    for field in fields:
        yield from _leaves(f"{name}.{field}", value[field].ravel()[0])


def _value(
    content: dict[str, object], source: str, stated: dict[str, tuple[int, ...]], path: Path
) -> np.ndarray[Any, Any]:
    names = source.partition("[")[0].split(".")
    if names[0] not in content:
        raise BadInput(str(path), f"has no variable {names[0]!r}; there are {shown(list(stated))}")
    value: Any = content[names[0]]
    for k, name in enumerate(names[1:], start=1):
        if name not in _fields(value):
            there = shown(list(_fields(value)))
            raise BadInput(f"{path} variable {'.'.join(names[:k])!r}", f"has no field {name!r}; there are {there}")
        value = value[name].ravel()[0]
    if _fields(value):
        raise BadInput(
            f"{path} variable {source!r}", f"is a struct; give one of its fields: {shown(list(_fields(value)))}"
        )
    return one_column(np.asarray(value), source, f"{path} variable {source!r}")


def _size(shape: tuple[int, ...]) -> int:
    size = 1
    for length in shape:
        size *= max(int(length), 0)
    return size
