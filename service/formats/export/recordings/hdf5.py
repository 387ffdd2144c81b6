"""HDF5: one group per sweep, one dataset per column, `time` as dimension scale. Needs `sweepid[hdf5]`."""

from pathlib import Path
from typing import Any

import h5py

from service.formats.export.recordings.metadata import (
    DOCUMENT,
    FORMAT,
    MEANINGS,
    UNKNOWN,
    URDF,
    Recordings,
    document,
    slides,
    unit_of,
)
from service.model.recording import Sweep
from service.store.files.columns import columns_of

_h5: Any = h5py  # has no types
_ALWAYS = ("id", "axis", "pose", "offset_velocity", "excitation", "measure_from", "sample_rate", "started_at", "repeat")
_MAYBE = ("period", "periods", "block")


def write(path: Path, recordings: Recordings) -> None:
    with _h5.File(str(path), "w") as file:
        file.attrs["format"] = FORMAT
        file.attrs["robot"] = recordings.robot.name
        if recordings.began != UNKNOWN:
            file.attrs["began"] = recordings.began.isoformat()
        file[DOCUMENT] = document(recordings)
        file[URDF] = recordings.robot.urdf_text
        for number, sweep in enumerate(recordings.sweeps, start=1):
            # ids are free text, and a slash in a name would create a group
            _write_sweep(file.create_group(f"sweeps/{number:04d}"), sweep, slides(recordings.robot, sweep.spec.axis))


def _write_sweep(group: Any, sweep: Sweep, prismatic: bool) -> None:
    attributes = {name: getattr(sweep.spec, name) for name in (*_ALWAYS, *_MAYBE)}
    for name, value in attributes.items():
        if value not in (None, ""):
            group.attrs[name] = value
    for name, column in columns_of(sweep.recording).items():
        dataset = group.create_dataset(name, data=column)
        dataset.attrs["units"] = unit_of(name, prismatic)
        dataset.attrs["long_name"] = MEANINGS[name]
        if name == "time":
            dataset.make_scale("time")
        else:
            dataset.dims[0].attach_scale(group["time"])
