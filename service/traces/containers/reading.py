"""Reads a trace file in a separate process: the parsers of these formats are large, and the files are untrusted.

The process gets a request file and a folder. It writes one array per sweep into the folder and returns the units.
"""

import asyncio
import importlib
import struct
import tempfile
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np

from service.errors import BadInput
from service.store.files.isolated_reader import LIMITS, Limits, read_isolated
from service.traces.containers.request import Array, Asked, Channel, Taken, Units

_READERS = {".mat": ("mat", "SciPy"), ".mf4": ("mdf4", "asammdf"), ".h5": ("hdf5", "h5py"), ".hdf5": ("hdf5", "h5py")}
# exceptions of the libraries for truncated or malicious files; memory and disk errors are not caught
_TORN = (
    ArithmeticError, AssertionError, AttributeError, BufferError, EOFError, LookupError, NameError, RuntimeError,
    SyntaxError, TypeError, ValueError, struct.error, zlib.error,
)  # fmt: skip


class _Reader(Protocol):
    LIBRARY_ERRORS: tuple[type[Exception], ...]

    def read(self, path: Path, sweeps: Sequence[Sequence[Channel]]) -> Iterator[Taken]: ...


def read_containers(path: Path, sweeps: Sequence[tuple[Channel, ...]], limits: Limits = LIMITS) -> tuple[Taken, ...]:
    """The requested channels of a file, by sweep. BadInput: unreadable, a channel is missing, or above a limit."""
    with tempfile.TemporaryDirectory(prefix="sweepid-trace-") as name:
        folder = Path(name)
        asked = Asked(file=str(path), sweeps=tuple(sweeps))
        (folder / "asked.json").write_text(asked.model_dump_json(), encoding="utf-8")
        answer: list[object] = asyncio.run(read_isolated(take, (folder / "asked.json", folder), str(path), limits))
        found = [Units.model_validate(units) for units in answer]
        return tuple(_stored(folder, number, units) for number, units in enumerate(found))


def take(asked: Path, folder: Path) -> list[dict[str, Any]]:
    """In the process: write ``N.npy`` for each sweep, rows as requested, clock last; return their `Units`."""
    wanted = Asked.model_validate_json(asked.read_bytes())
    answer: list[dict[str, Any]] = []
    for number, taken in enumerate(read_here(Path(wanted.file), wanted.sweeps)):
        rows = taken.columns if taken.clock is None else np.vstack([taken.columns, taken.clock])
        np.save(folder / f"{number}.npy", rows, allow_pickle=False)
        answer.append(Units(units=taken.units, clocked=taken.clock is not None).model_dump(mode="json"))
    return answer


def read_here(path: Path, sweeps: Sequence[Sequence[Channel]]) -> Iterator[Taken]:
    """The same in this process, one sweep after the other."""
    room, library = _READERS[path.suffix.lower()]
    if not path.is_file():
        raise BadInput(str(path), "is not a file" if path.exists() else "file does not exist")
    try:
        reader = cast(_Reader, importlib.import_module(f"service.traces.containers.{room}"))
    except ModuleNotFoundError as error:
        raise BadInput(str(path), f"needs {error.name}: install sweepid with its extra, `sweepid[{room}]`") from None
    try:
        yield from reader.read(path, sweeps)
    except (*_TORN, OSError, *reader.LIBRARY_ERRORS) as error:
        reason = " ".join(str(error).split())[:300]
        raise BadInput(str(path), f"cannot be read by {library}: {reason or type(error).__name__}") from None


def _stored(folder: Path, number: int, units: Units) -> Taken:
    rows = cast(Array, np.load(folder / f"{number}.npy", allow_pickle=False))
    return Taken(rows[:-1], units.units, rows[-1]) if units.clocked else Taken(rows, units.units, None)
