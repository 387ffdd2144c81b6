"""MATLAB, MDF4 and HDF5 files that fuzzing starts from: as the product and others write them, small and compressed."""

import functools
import io
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, cast

import asammdf
import h5py
import numpy as np
from scipy.io import savemat

from service.formats.export.recordings import write_recordings
from service.formats.traces.containers import ChannelName, read_here
from service.model.configuration import read_robot
from service.store.files.bundle import Bundle
from tests.forked import forked
from tests.fuzz.seeds import CONFIG, Seed, columns, one, sweep

_h5 = cast(Any, h5py)  # without types
ASKED = ("time", "effort", "velocity", "position")


def read(path: Path) -> None:
    """One sweep, in a copy of this process.

    What C code of others does to its process is no finding: the product lets it happen to one of its own.
    """
    group = {".mat": None, ".mf4": 0, ".h5": "sweeps/0001"}[path.suffix]
    asked = [[ChannelName(source=name, group=group) for name in ASKED]]
    forked(lambda: deque(read_here(path, asked), maxlen=0))


@functools.cache
def _written(suffix: str) -> bytes:
    robot = read_robot(CONFIG / "robots/emps.yaml")
    given = sweep(1)
    spec = given.spec.model_copy(update={"axis": robot.joints[0], "pose": (0.0,)})
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"a{suffix}"
        write_recordings(path, Bundle(robot, (type(given)(spec, given.recording),)))
        return path.read_bytes()


@functools.cache
def _compressed_mdf4() -> bytes:
    """Counts with a linear conversion, samples that are invalid, and blocks that are packed."""
    time = np.arange(200) / 50
    invalid = np.arange(200) == 3
    counts, clock = np.arange(200, dtype=np.int16), ("clock", 1)
    linear: Any = {"a": 0.5, "b": 1.0}
    signals = [
        asammdf.Signal(counts, time, name=name, unit="s", conversion=linear, master_metadata=clock)
        for name in ASKED[:3]
    ]
    last = asammdf.Signal(np.arange(200.0), time, name="position", invalidation_bits=invalid, master_metadata=clock)
    signals.append(last)
    with TemporaryDirectory() as folder, asammdf.MDF(version="4.10") as file:
        file.append(signals, acq_name="drive", common_timebase=True)
        file.save(path := Path(folder) / "a.mf4", compression=2)
        return path.read_bytes()


@functools.cache
def _compressed_hdf5() -> bytes:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "a.h5"
        with _h5.File(str(path), "w", libver="latest") as file:
            for name in ASKED:
                made = file.create_dataset(
                    f"sweeps/0001/{name}", data=np.arange(300.0), chunks=(64,), compression="gzip", fletcher32=True
                )
                made.attrs["unit"] = "Nm"
            file["soft"] = _h5.SoftLink("/sweeps")
        return path.read_bytes()


def _without_times(content: bytes) -> bytes:
    """When asammdf wrote it stands in each block of the file's history."""
    packed, at = bytearray(content), content.find(b"##FH")
    while at >= 0:
        packed[at + 40 : at + 48] = bytes(8)
        at = content.find(b"##FH", at + 1)
    return bytes(packed)


def mdf4() -> Iterator[Seed]:
    yield one("a.mf4", _without_times(_written(".mf4")))
    yield one("a.mf4", _without_times(_compressed_mdf4()))


def hdf5() -> Iterator[Seed]:
    yield one("a.h5", _written(".h5"))
    yield one("a.h5", _compressed_hdf5())


def mat() -> Iterator[Seed]:
    """Plain and compressed, and of version 4."""
    for name, more in (("a.mat", {}), ("b.mat", {"do_compression": True}), ("c.mat", {"format": "4"})):
        out = io.BytesIO()
        savemat(out, columns(), **more)  # pyright: ignore[reportArgumentType]  a file object is taken, by its documentation
        content = out.getvalue()
        stamped = content if more.get("format") else content[:20].ljust(116) + content[116:]  # without time of writing
        yield one(name, stamped)
