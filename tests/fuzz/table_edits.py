"""Edits of Arrow streams, Parquet files and zips by what they hold."""

import io
import zipfile
from collections.abc import Callable
from random import Random
from typing import Any, cast

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pa_parquet

from tests.fuzz import bytes_edits

_arrow, _parquet = cast(Any, pa), cast(Any, pa_parquet)
_STRANGE = (float("nan"), float("inf"), -1e308, 1e308, 5e-324, -0.0, 1e16)


def edit_parquet(content: bytes, rng: Random) -> bytes:
    """ArrowException or OSError where the content is no table any more."""
    out = io.BytesIO()
    table = _edited(_parquet.read_table(io.BytesIO(content)), rng)
    codec = rng.choice(("snappy", "none", "gzip", "zstd"))
    _parquet.write_table(table, out, compression=codec, row_group_size=rng.choice((None, 7)))
    return out.getvalue()


def edit_stream(content: bytes, rng: Random) -> bytes:
    """The same of an Arrow stream."""
    table = _edited(_arrow.ipc.open_stream(io.BytesIO(content)).read_all(), rng)
    out = io.BytesIO()
    with _arrow.ipc.new_stream(out, table.schema) as writer:
        writer.write_table(table, max_chunksize=rng.choice((None, 100)))
    return out.getvalue()


def _edited(table: Any, rng: Random) -> Any:
    names = table.column_names
    at, rows = rng.randrange(len(names)), table.num_rows
    match rng.randrange(9):
        case 0:
            return table.drop_columns([names[at]])
        case 1:
            return table.append_column(names[at], table.column(at))
        case 2:
            return table.rename_columns([*names[:at], rng.choice(("x", "", "time", "n" * 5000)), *names[at + 1 :]])
        case 3:
            return table.set_column(at, names[at], _foreign(rows, rng))
        case 4:
            return table.slice(rng.randrange(rows + 1), rng.choice((0, 1, 2, rows)))
        case 5:
            return _arrow.concat_tables([table, table])
        case 6:
            return table.select(rng.sample(names, len(names)))
        case _:
            values = np.array(table.column(at).to_numpy(), dtype=float)
            if rows:
                values[rng.randrange(rows) :: rng.choice((1, rows))] = rng.choice(_STRANGE)
            return table.set_column(at, names[at], _arrow.array(values))


def _foreign(rows: int, rng: Random) -> Any:
    """A column of another type."""
    kinds: tuple[Callable[[], Any], ...] = (
        lambda: _arrow.array(["x"] * rows),
        lambda: _arrow.nulls(rows),
        lambda: _arrow.array([None] * rows, _arrow.float64()),
        lambda: _arrow.array([[1.0]] * rows, _arrow.list_(_arrow.float64())),
        lambda: _arrow.array([{"a": 1}] * rows),
        lambda: _arrow.array([0] * rows, _arrow.timestamp("ns")),
        lambda: _arrow.array([2**64 - 1] * rows, _arrow.uint64()),
        lambda: _arrow.array([True] * rows),
        lambda: _arrow.array(np.arange(rows, dtype=np.float16)),
        lambda: _arrow.array([1] * rows, _arrow.decimal128(38, 3)),
        lambda: _arrow.array(["x"] * rows).dictionary_encode(),
        lambda: _arrow.array([1] * rows).dictionary_encode(),
    )
    return rng.choice(kinds)()


def edit_zip(content: bytes, rng: Random, edit_member: Callable[[str, bytes, Random], bytes]) -> bytes:
    """BadZipFile where the content is no archive any more."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = [(name, archive.read(name)) for name in archive.namelist()]
    at = rng.randrange(len(members))
    name, inside = members[at]
    match rng.randrange(6):
        case 0:
            strange = ("../x", "/x", "a" * 300, "bundle.json/x", "x\x07", "sweeps", "", "ä", "a/" * 200 + "b", "c:\\x")
            members[at] = (rng.choice(strange), inside)
        case 1:
            del members[at]
        case 2:
            members.append((name.lower(), bytes_edits.edit(inside, rng)))
        case _:
            members[at] = (name, edit_member(name, inside, rng))
    out = io.BytesIO()
    method = rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA))
    with zipfile.ZipFile(out, "w", method) as archive:
        for name, inside in members:
            archive.writestr(zipfile.ZipInfo(name or "x"), inside, method)
    packed = bytearray(out.getvalue())
    if rng.random() < 0.3:  # what the directory at the end says of them
        at = packed.rfind(b"PK\x01\x02")
        packed[at + rng.randrange(4, 46)] = rng.choice((0, 1, 0x7F, 0xFF))
    return bytes(packed)
