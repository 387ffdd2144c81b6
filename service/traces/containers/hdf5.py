"""Datasets of an HDF5 file, one per column. Needs `sweepid[hdf5]`.

Only the named file is opened: links to other files, virtual datasets and external storage are rejected.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, cast

import h5py
import numpy as np

from service.errors import BadInput
from service.store.files.columns import MOST_NUMBERS
from service.traces.containers.request import Channel, Taken, check_numbers, in_rows, shown

_h5: Any = h5py  # has no types; each value is checked when it is read
LIBRARY_ERRORS: tuple[type[Exception], ...] = ()
_UNIT_NAMES = ("units", "unit", "Units", "Unit")  # of the attribute; the first is that of netCDF and NeXus


def read(path: Path, sweeps: Sequence[Sequence[Channel]]) -> Iterator[Taken]:
    """The datasets, one sweep after the other; HDF5 has no clock."""
    with _h5.File(str(path), "r") as file:
        for channels in sweeps:
            datasets = [_dataset(file, channel, str(path)) for channel in channels]
            names = [_name(channel) for channel in channels]
            lengths = {name: int(dataset.size) for name, dataset in zip(names, datasets, strict=True)}
            if len(set(lengths.values())) > 1:
                sizes = ", ".join(f"{name} has {length}" for name, length in lengths.items())
                raise BadInput(str(path), f"datasets of one sweep differ in length, nothing is resampled: {sizes}")
            length = next(iter(lengths.values()), 0)
            check_numbers(length, len(datasets), MOST_NUMBERS, str(path))
            columns = (np.asarray(dataset[()], np.float64).ravel() for dataset in datasets)
            yield Taken(in_rows(columns, len(datasets), length), tuple(_unit(dataset) for dataset in datasets), None)


def _name(channel: Channel) -> str:
    return channel.source if channel.group is None else f"{channel.group}/{channel.source}"


def _dataset(file: Any, channel: Channel, path: str) -> Any:
    """The dataset, reached only by links inside the file, if it is a numeric column."""
    name = _name(channel)
    place, here = f"{path} dataset {name}", file
    for part in (part for part in name.split("/") if part):
        link = here.get(part, getlink=True) if isinstance(here, _h5.Group) else None
        if link is None:
            there = shown(list(map(str, here))) if isinstance(here, _h5.Group) else "none"
            raise BadInput(place, f"{part!r} does not exist; there are {there}")
        if not isinstance(link, _h5.HardLink):
            raise BadInput(
                place,
                f"{part!r} is a link to {getattr(link, 'path', 'elsewhere')}; give the name of the dataset itself",
            )
        here = here[part]
    if not isinstance(here, _h5.Dataset):
        raise BadInput(place, "is a group, not a dataset")
    if here.is_virtual or here.external:
        raise BadInput(place, "has its values in other files, which are not read: export it into one file")
    if here.dtype.kind not in "iuf" or here.shape is None or here.size != max(here.shape, default=0):
        raise BadInput(place, f"is not a column of numbers: {here.dtype} {here.shape}")
    return here


def _unit(dataset: Any) -> str:
    for name in _UNIT_NAMES:
        if name in dataset.attrs:
            value: object = np.asarray(dataset.attrs[name]).ravel()[:1].tolist()
            given = cast("list[object]", value)[0] if value else ""
            return (given.decode("utf-8", "replace") if isinstance(given, bytes) else str(given)).strip()[:60]
    return ""
