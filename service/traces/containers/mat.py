"""Variables of a MATLAB file of version 4 to 7.2, one per column; version 7.3 is HDF5 and must be named `.h5`."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from scipy.io import loadmat, whosmat
from scipy.io.matlab import MatReadError

from service.errors import BadInput
from service.store.files.columns import MOST_NUMBERS
from service.traces.containers.request import Channel, Taken, check_numbers, in_rows, shown

LIBRARY_ERRORS: tuple[type[Exception], ...] = (MatReadError,)


def read(path: Path, sweeps: Sequence[Sequence[Channel]]) -> Iterator[Taken]:
    """The variables, one sweep after the other; the file contains neither units nor a clock.

    The shapes in the file header are compared with the limit before values are read.
    """
    stated = {str(name): shape for name, shape, _ in whosmat(str(path))}
    for channels in sweeps:
        names = [channel.source for channel in channels]
        present = sorted(set(names) & set(stated))
        check_numbers(sum(_size(stated[name]) for name in present), 1, MOST_NUMBERS, str(path))
        content = loadmat(str(path), variable_names=present)  # a truncated file is rejected here, whatever it lacks
        for name in names:
            if name not in content:
                raise BadInput(str(path), f"has no variable {name!r}; there are {shown(list(stated))}")
        lengths = {name: _length(content[name], f"{path} variable {name!r}") for name in names}
        if len(set(lengths.values())) > 1:
            sizes = ", ".join(f"{name} has {lengths[name]}" for name in names)
            raise BadInput(str(path), f"variables of one sweep differ in length, nothing is resampled: {sizes}")
        columns = (_column(content, names, k) for k in range(len(names)))
        yield Taken(in_rows(columns, len(names), lengths[names[0]]), ("",) * len(names), None)


def _size(shape: tuple[int, ...]) -> int:
    size = 1
    for length in shape:
        size *= max(int(length), 0)
    return size


def _length(content: object, place: str) -> int:
    value = np.asarray(content)
    if value.dtype.kind not in "iuf" or value.size != max(value.shape, default=0):
        raise BadInput(place, f"is not a column of numbers: {value.dtype} {value.shape}")
    return value.size


def _column(content: dict[str, object], names: Sequence[str], k: int) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Column of the name `k`; a variable is freed after its last use."""
    value = content[names[k]] if names[k] in names[k + 1 :] else content.pop(names[k])
    return np.asarray(value, np.float64).ravel()
