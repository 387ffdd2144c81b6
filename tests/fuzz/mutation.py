"""A file, edited some times, as what it is by its name or by its bytes alone."""

import lzma
import xml.etree.ElementTree as ET
import zipfile
import zlib
from collections.abc import Callable, Mapping
from pathlib import PurePosixPath
from random import Random
from typing import Any, cast

import pyarrow as pa
import yaml

from tests.fuzz import bytes_edits, line_edits, table_edits, tree_edits, xml_edits

Edit = Callable[[bytes, Random], bytes]
_STRUCTURED = 0.75  # of the edits
_TIMES = (1, 1, 1, 1, 2, 2, 3, 6)
_NO_SUCH = (
    ValueError, TypeError, LookupError, RecursionError, OverflowError, AttributeError, OSError, NotImplementedError,
    RuntimeError, EOFError, MemoryError, yaml.YAMLError, ET.ParseError, zipfile.BadZipFile, zlib.error,
    lzma.LZMAError, cast(Any, pa).ArrowException,
)  # fmt: skip


def mutated(name: str, content: bytes, rng: Random) -> bytes:
    """Some edits of the file, one after the other."""
    for _ in range(rng.choice(_TIMES)):
        content = _edited(name, content, rng)
    return content


def _edited(name: str, content: bytes, rng: Random) -> bytes:
    structured = _EDITS.get(PurePosixPath(name).suffix.lower())
    if structured is not None and rng.random() < _STRUCTURED:
        try:
            return structured(content, rng)
        except _NO_SUCH:  # an edit before made it something else; which is what we want
            pass
    return bytes_edits.edit(content, rng)


def _zip(content: bytes, rng: Random) -> bytes:
    return table_edits.edit_zip(content, rng, _edited)


_EDITS: Mapping[str, Edit] = {
    ".yaml": tree_edits.edit_yaml,
    ".json": tree_edits.edit_json,
    **dict.fromkeys((".urdf", ".xml", ".dae"), xml_edits.edit),
    **dict.fromkeys((".csv", ".obj", ".stl", ".eds", ".dcf"), line_edits.edit),
    ".parquet": table_edits.edit_parquet,
    ".arrow": table_edits.edit_stream,
    ".zip": _zip,
}
