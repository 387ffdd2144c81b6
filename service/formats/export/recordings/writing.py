"""Writes recordings of a bundle to a file of another tool; the suffix determines the format. All or nothing."""

import importlib
from collections.abc import Collection
from datetime import datetime
from pathlib import Path
from typing import Protocol, cast
from uuid import uuid4

from service.formats.export.recordings.metadata import UNKNOWN, Recordings
from service.model.errors import BadInput, writing
from service.model.recording import Recording
from service.store.files.bundle import Bundle, write_bundle
from service.store.files.columns import write_columns

_MODULES = {".mf4": "mdf4", ".h5": "hdf5", ".hdf5": "hdf5", ".mcap": "mcap"}
FORMATS = (*_MODULES, ".csv")


class _Writer(Protocol):
    def write(self, path: Path, recordings: Recordings) -> None: ...


def write_recordings(
    out: Path, bundle: Bundle, ids: Collection[str] = (), began: datetime | None = None
) -> tuple[str, ...]:
    """Write all sweeps, or those of these ids, to `out`, which must not exist; returns the written ids.

    `.csv` contains one sweep. A name without suffix becomes a bundle with samples in CSV. BadInput: nothing is written.
    """
    there = [sweep.spec.id for sweep in bundle.sweeps]
    for wanted in ids:
        if wanted not in there:
            raise BadInput("--sweep", f"sweep {wanted!r} does not exist; there are {', '.join(there)}")
    sweeps = [sweep for sweep in bundle.sweeps if not ids or sweep.spec.id in ids]
    recordings = Recordings(bundle.robot, sweeps, began or UNKNOWN)
    with writing(out):
        if out.suffix == "":
            write_bundle(out, bundle.robot, sweeps, ".csv")
        else:
            _write_file(out, recordings)
    return tuple(sweep.spec.id for sweep in sweeps)


def _write_file(out: Path, recordings: Recordings) -> None:
    suffix = out.suffix.lower()
    if suffix not in FORMATS:
        raise BadInput(
            str(out), f"recordings are written as {', '.join(FORMATS)}, or without suffix as a folder of CSV"
        )
    if out.exists():
        raise BadInput(str(out), "exists already")
    partial = out.with_name(f".{out.stem[:100]}.{uuid4().hex}.partial{suffix}")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        if suffix == ".csv":
            write_columns(partial, _only(recordings, str(out)))
        else:
            _writer(_MODULES[suffix], out).write(partial, recordings)
        partial.rename(out)
    finally:
        if partial.exists():
            partial.unlink()


def _only(recordings: Recordings, place: str) -> Recording:
    if len(recordings.sweeps) != 1:
        ids = ", ".join(sweep.spec.id for sweep in recordings.sweeps)
        raise BadInput(
            place,
            f"can contain one sweep: choose it with --sweep ({ids}), or give a name without suffix for all sweeps",
        )
    return recordings.sweeps[0].recording


def _writer(module: str, out: Path) -> _Writer:
    try:
        return cast(_Writer, importlib.import_module(f"service.formats.export.recordings.{module}"))
    except ModuleNotFoundError as error:
        raise BadInput(str(out), f"needs {error.name}: install sweepid with its extra, `sweepid[{module}]`") from None
