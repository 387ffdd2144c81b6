"""Datasets of an HDF5 file, one per column. Needs `sweepid[hdf5]`.

Only the named file is opened: links to other files, virtual datasets and external storage are rejected.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, cast

import h5py
import numpy as np

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
    split_source,
    taken_of,
)
from service.store.files.columns import MOST_NUMBERS

_h5: Any = h5py  # has no types; each value is checked when it is read
LIBRARY_ERRORS: tuple[type[Exception], ...] = ()


def read(path: Path, sweeps: Sequence[Sequence[ChannelName]]) -> Iterator[Taken]:
    """The datasets, one sweep after the other; HDF5 has no clock."""
    with _h5.File(str(path), "r") as file:
        for channels in sweeps:
            named = [ChannelName(source=_name(channel), group=None) for channel in channels]
            datasets = [_dataset(file, split_source(channel.source)[0], str(path)) for channel in named]
            check_numbers(sum(int(each.size) for each in datasets), 1, MOST_NUMBERS, str(path))
            columns = [
                one_column(np.asarray(dataset[()]), channel.source, f"{path} dataset {channel.source}")
                for channel, dataset in zip(named, datasets, strict=True)
            ]
            yield taken_of(named, columns, tuple(_unit(dataset) for dataset in datasets), f"{path} dataset")


def listed(path: Path) -> tuple[ListedChannel, ...]:
    """The columns of numbers, reached only by links inside the file."""
    with _h5.File(str(path), "r") as file:
        found = tuple(_below(file, ""))
        objects = [name for name in map(str, file) if _is_object(file.get(name))] if not found else []
        if objects:
            raise matlab_object(objects[0], _class(file[objects[0]]), path)
        return found


def _is_object(here: Any) -> bool:
    return here is not None and "MATLAB_object_decode" in here.attrs


def _class(here: Any) -> str:
    kind: Any = here.attrs.get("MATLAB_class", b"object")
    return kind.decode("utf-8", "replace") if isinstance(kind, bytes) else str(kind)


def _below(group: Any, path: str) -> Iterator[ListedChannel]:
    for name in map(str, group):
        link, place = group.get(name, getlink=True), f"{path}{name}"
        if not isinstance(link, _h5.HardLink) or name.startswith("#"):  # MATLAB keeps its references in #refs#
            continue
        here = group[name]
        if isinstance(here, _h5.Group):
            yield from _below(here, f"{place}/")
        elif _is_object(here):
            continue
        elif not (here.is_virtual or here.external) and here.shape:
            shape = np.lib.stride_tricks.as_strided(np.zeros(1, here.dtype), here.shape, (0,) * len(here.shape))
            yield from (ListedChannel(name=each, unit=_unit(here)) for each in columns_in(place, shape))


def _name(channel: ChannelName) -> str:
    return channel.source if channel.group is None else f"{channel.group}/{channel.source}"


def _dataset(file: Any, name: str, path: str) -> Any:
    """The dataset of numbers, by links inside the file; fields of a MATLAB struct also as ``log.q``."""
    if name not in file and name.replace(".", "/") in file:
        name = name.replace(".", "/")
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
    if _is_object(here):
        raise matlab_object(name, _class(here), Path(path))
    if not isinstance(here, _h5.Dataset):
        raise BadInput(place, "is a group, not a dataset")
    if here.is_virtual or here.external:
        raise BadInput(place, "has its values in other files, which are not read: export it into one file")
    if here.dtype.kind not in "iuf" or here.shape is None or len(here.shape) > 2:
        raise BadInput(place, f"is not a column of numbers: {here.dtype} {here.shape}")
    return here


def _unit(dataset: Any) -> str:
    for name in ("units", "unit", "Units", "Unit"):  # of the attribute; the first is that of netCDF and NeXus
        if name in dataset.attrs:
            value: object = np.asarray(dataset.attrs[name]).ravel()[:1].tolist()
            given = cast("list[object]", value)[0] if value else ""
            return (given.decode("utf-8", "replace") if isinstance(given, bytes) else str(given)).strip()[:60]
    return ""
