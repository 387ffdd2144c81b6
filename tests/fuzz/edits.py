"""A file, edited some times, as what it is by its name or by its bytes alone."""

import copy
import io
import json
import re
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import PurePosixPath
from random import Random
from typing import Any, cast

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pa_parquet
import yaml

LONG = "n" * 5000
DEEP = 3000
LONGEST = 2_000_000  # bytes; doubling of doubled parts would go on and on

BYTES = (
    b"\x00", b"\xff\xff\xff\xff", b"\x00\x00\x00\x80", b"\xef\xbb\xbf", b"\xff\xfe", b"\xed\xa0\x80", b"\r", b"\n\n",
    b"\t", b"%", b"&a ", b"*a", b"<<", b"<!DOCTYPE x>", b"<![CDATA[", b"]]>", b"&#0;", b"&lt;", b"[" * 200, b"{",
    b'"', b"'", b"#", b"nan", b"1e999", b"-", b"9" * 400, b"PK\x03\x04", b"PAR1", b"ARROW1", b"\x1f\x8b",
)  # fmt: skip
PLAIN: tuple[object, ...] = (
    None, True, False, "", "x", 0, -1, 1, 3, 0.5, -0.0, float("nan"), float("inf"), float("-inf"), 1e308, -1e308,
    5e-324, 1e-300, 1e16, 2**31, 2**53 + 1, 2**63, 2**64, -(2**63) - 1, 10**400, [], {}, [[]], [1, 2], [None],
    {"a": 1}, [0.0] * 7, LONG, "a\x07b", "\x1b[31mred", "..", "../../../../dev/zero", "/dev/null", "%s{0}", "nan",
    "1e999", "0x10", "true", "ä\u202eb", "joint_1", "\n",
)  # fmt: skip
YAML = (
    ".nan", "-.inf", "1e308", "5e-324", "-0", "2001-13-45", "2001-01-01T25:61:61", "0b", "0x", "0b_", "_",
    "1:99:99.9", "9" * 5000, "=", "<<: 1", "<<: [1]", "!!binary x", "!!int abc", "!!float x", "!!bool x",
    "!!timestamp x", "!!int ''", "!!python/object:os.system x", "!!set {a}", "!!omap [a: 1]", "!!pairs [a]",
    "!!null x", "*none", "&a [*a]", "&a {b: *a}", "[" * DEEP, "[" * DEEP + "]" * DEEP, "{a: " * 400 + "1" + "}" * 400,
    "{a: 1, a: 2}", "{? [1] : 2}", "{? {} : 2}", "|", ">", "\t", "'", "%", "@", "`", "- - - x", "{1: 2}", "{null: 2}",
    "{.nan: 2}", "!x y", "---\n--- x", "!!str 5", "!!seq [1]", "!!map {a: 1}", "\x00", "\x85", "1e400", "0o8",
    "190:20:30", "+", "-", "~",
    "[&b [x, x, x], &c [*b, *b, *b], &d [*c, *c, *c], &e [*d, *d, *d], &f [*e, *e, *e], &g [*f, *f, *f], *g]",
)  # fmt: skip
JSON = (
    "NaN", "Infinity", "-Infinity", "1e999", "-1e999", "-0", "1e-400", "9" * 5000, '"\\ud800"', '"\\u0000"',
    "[" * DEEP, "[" * DEEP + "]" * DEEP, '{"a":' * DEEP + "1" + "}" * DEEP, '{"a": 1, "a": 2}', "tru", "'x'", "[1,]",
    '"', "1.", ".5", "0x10", "+1", "\ufeff1", '"\t"', '{"__proto__": 1}', "[" * 190 + "]" * 190,
)  # fmt: skip
TEXT = (
    "", " ", "0", "-0", "1", "-1", "nan", "inf", "-inf", "1e308", "1e16", "1e-300", "5e-324", "1e999", "9" * 5000,
    str(2**31), str(2**64), "0x", "0xFFFFFFFFFFFFFFFFFF", "0x80000000", "abc", "1,5", "1_0", "٣", "$NODEID+0x80",
    "$NODEID", "%(x)s", "a" * 5000, "..", "/dev/null", "../../../dev/zero", "\x00", "\x07", "1 2 3",
    "1e308 1e308 1e308", "0 0 0", "1e-300 0 0", "nan 0 0", "true", "fixed", "mesh", "package://a/../b",
    "package://p/m.stl", "file:///etc", "é", "\u2028", "65536", "255", "-32768", "3.5", "[x]", "=", ";", '"',
)  # fmt: skip
XML_HEADS = (
    '<?xml version="1.0" encoding="utf-16"?>', '<?xml version="1.0" encoding="none"?>', "<!DOCTYPE x>",
    '<?xml version="1.0" encoding="latin-1"?>', '<!DOCTYPE r [<!ENTITY a "b"><!ENTITY c "&a;&a;&a;&a;">]>', "\ufeff",
    " ", '<?xml version="1.0" encoding="cp037"?>', '<?xml version="1.0" encoding="idna"?>', "<!-- -- -->", "<?x?>",
    '<?xml version="1.0" encoding="utf-7"?>', '<?xml version="1.0" encoding="hex"?>',
)  # fmt: skip
MEMBERS = ("../x", "/x", "a" * 300, "bundle.json/x", "x\x07", "sweeps", "", "ä", "a/" * 200 + "b", "c:\\x")  # of a zip
NUMBERS = (float("nan"), float("inf"), -1e308, 1e308, 5e-324, -0.0, 1e16)  # in a column

_STRUCTURED = 0.75  # of the edits
_TIMES = (1, 1, 1, 1, 2, 2, 3, 6)
_MARK = "RAW-PLACE"  # stands in a tree where text goes that no emitter would write
_CELLS = re.compile(r"([,;=\s])")
_LOADER, _DUMPER = getattr(yaml, "CSafeLoader", yaml.SafeLoader), getattr(yaml, "CSafeDumper", yaml.SafeDumper)
_arrow, _parquet = cast(Any, pa), cast(Any, pa_parquet)  # without types


def edited(name: str, content: bytes, rng: Random) -> bytes:
    """Some edits of the file, one after the other."""
    for _ in range(rng.choice(_TIMES)):
        content = _once(name, content, rng)
    return content


def _once(name: str, content: bytes, rng: Random) -> bytes:
    structured = _EDITS.get(PurePosixPath(name).suffix.lower())
    if structured is not None and rng.random() < _STRUCTURED:
        try:
            return structured(content, rng)
        except Exception:  # noqa: BLE001 - an edit before made it something else; which is what we want
            pass
    return _bytes(content, rng)


def _bytes(content: bytes, rng: Random) -> bytes:
    """Flipped, cut, doubled, strange ones put in."""
    if not content:
        return rng.choice(BYTES)
    at, length, token = rng.randrange(len(content)), rng.choice((1, 2, 4, 8, 64, 1024)), rng.choice(BYTES)
    before, after = content[:at], content[at:]
    other = rng.randrange(len(content))
    made = rng.choice(
        (
            before + bytes([content[at] ^ 1 << rng.randrange(8)]) + after[1:],
            before + bytes([rng.randrange(256)]) + after[1:],
            before,
            before + after[length:],
            content[: at + length] + after,
            before + token + after,
            before + token + after[len(token) :],
            before + content[other : other + length] + after[length:],
        )
    )
    return made if len(made) <= LONGEST else before


def _lines(content: bytes, rng: Random) -> bytes:
    """CSV, OBJ, STL as text, EDS and DCF: cells and lines that are another, doubled, gone."""
    lines = content.decode().splitlines()
    at = rng.choice((0, rng.randrange(len(lines)), rng.randrange(len(lines))))
    parts, word = _CELLS.split(lines[at]), rng.choice(TEXT)
    match rng.randrange(6):
        case 0 | 1:
            parts[2 * rng.randrange((len(parts) + 1) // 2)] = word
            lines[at] = "".join(parts)
        case 2:
            del parts[rng.randrange(len(parts))]
            lines[at] = "".join(parts)
        case 3:
            lines[at] = lines[rng.randrange(len(lines))]
        case 4:
            lines[at : at + 1] = [lines[at]] * rng.choice((0, 2))
        case _:
            column = 2 * rng.randrange(8)
            table = [_CELLS.split(line) for line in lines]
            lines = ["".join([*row[:column], word, *row[column + 1 :]]) for row in table]
    return ("\n".join(lines) + "\n").encode()


def _yaml(content: bytes, rng: Random) -> bytes:
    tree = _tree(yaml.load(content.decode(), Loader=_LOADER), rng)
    text = yaml.dump(tree, Dumper=_DUMPER, sort_keys=False, allow_unicode=True, width=10_000)
    return _doubled(text.replace(_MARK, rng.choice(YAML)), rng)


def _json(content: bytes, rng: Random) -> bytes:
    text = json.dumps(_tree(json.loads(content), rng), indent=1)
    return _doubled(text.replace(f'"{_MARK}"', rng.choice(JSON)), rng)


def _doubled(text: str, rng: Random) -> bytes:
    """Sometimes a line stands twice, and with it its key."""
    lines = text.splitlines(keepends=True)
    if rng.random() > 0.9:
        lines.insert(at := rng.randrange(len(lines)), lines[at])
    return "".join(lines).encode("utf-8", "surrogatepass")


def _tree(tree: Any, rng: Random) -> Any:
    """With one value of another type, or a key that is gone, double or strange."""
    tree = copy.deepcopy(tree)  # of aliases, one place alone is to change
    places = list(_places(tree))
    holder, key = rng.choice(places)
    match rng.randrange(10):
        case 0 | 1 | 2:
            holder[key] = copy.deepcopy(rng.choice(PLAIN))
        case 3 | 4 | 5:
            holder[key] = _MARK
        case 6:
            del holder[key]
        case 7:
            holder[key] = _turned(holder[key])
        case 8 if isinstance(holder, dict):
            holder[rng.choice(("x", "", LONG, "a.b", "\x07", 1, None, True))] = holder.pop(key)
        case 8:
            holder.insert(key, copy.deepcopy(holder[key]))
        case _:
            other_holder, other = rng.choice(places)
            holder[key] = copy.deepcopy(other_holder[other])
    return tree


def _turned(value: Any) -> Any:
    """The same as another type, or a number beside it."""
    match value:
        case bool() | None:
            return "no"
        case int() | float():
            return -value
        case str():
            return [value]
        case list():
            return {str(number): part for number, part in enumerate(value)}
        case _:
            return list(value)


def _places(tree: Any) -> Iterator[tuple[Any, Any]]:
    """(holder, key) of every value inside."""
    keys = list(tree) if isinstance(tree, dict) else range(len(tree)) if isinstance(tree, list) else ()
    for key in keys:
        yield tree, key
        yield from _places(tree[key])


def _xml(content: bytes, rng: Random) -> bytes:
    """Elements moved, doubled, gone; attributes and texts that are no such thing."""
    if rng.random() < 0.03:
        return rng.choice(XML_HEADS).encode() + content
    root = ET.fromstring(content)
    pairs = [(parent, child) for parent in root.iter() for child in parent]
    (parent, element), (_, other) = rng.choice(pairs), rng.choice(pairs)
    match rng.randrange(9):
        case 0 | 1 | 2 if element.attrib:
            element.set(rng.choice(sorted(element.attrib)), rng.choice(TEXT))
        case 3 if element.attrib:
            del element.attrib[rng.choice(sorted(element.attrib))]
        case 0 | 1 | 2 | 3 | 4:
            element.text = rng.choice(TEXT)
        case 5:
            parent.remove(element)
        case 6 if len(content) < LONGEST / 4:
            other.append(copy.deepcopy(element))
        case 7 if rng.random() < 0.1:
            for _ in range(rng.choice((60, 2000))):
                element = ET.SubElement(element, element.tag)
        case _:
            element.tag, element.attrib, other.attrib = other.tag, dict(other.attrib), dict(element.attrib)
    # control characters are written as they are: no reader may take them, nor break on them
    return ET.tostring(root, encoding="unicode").encode("utf-8", "surrogatepass")


def _parquet_file(content: bytes, rng: Random) -> bytes:
    out = io.BytesIO()
    table = _table(_parquet.read_table(io.BytesIO(content)), rng)
    codec = rng.choice(("snappy", "none", "gzip", "zstd"))
    _parquet.write_table(table, out, compression=codec, row_group_size=rng.choice((None, 7)))
    return out.getvalue()


def _stream(content: bytes, rng: Random) -> bytes:
    table = _table(_arrow.ipc.open_stream(io.BytesIO(content)).read_all(), rng)
    out = io.BytesIO()
    with _arrow.ipc.new_stream(out, table.schema) as writer:
        writer.write_table(table, max_chunksize=rng.choice((None, 100)))
    return out.getvalue()


def _table(table: Any, rng: Random) -> Any:
    """Columns of another type, name or order, double or gone; rows that are gone, numbers that are none."""
    names = table.column_names
    at, rows = rng.randrange(len(names)), table.num_rows
    match rng.randrange(8):
        case 0:
            return table.drop_columns([names[at]])
        case 1:
            return table.append_column(names[at], table.column(at))
        case 2:
            return table.rename_columns([*names[:at], rng.choice(("x", "", "time", LONG)), *names[at + 1 :]])
        case 3:
            return table.set_column(at, names[at], _foreign(rows, rng))
        case 4:
            return table.slice(rng.randrange(rows + 1), rng.choice((0, 1, 2, rows)))
        case 5:
            return _arrow.concat_tables([table, table]).select(rng.sample(names, len(names)))
        case _:
            values = np.array(table.column(at).to_numpy(), dtype=float)
            values[rng.randrange(rows) :: rng.choice((1, rows))] = rng.choice(NUMBERS)
            return table.set_column(at, names[at], _arrow.array(values))


def _foreign(rows: int, rng: Random) -> Any:
    """A column of another type."""
    value, kind = rng.choice(
        (
            ("x", None), (None, None), (None, _arrow.float64()), ([1.0], None), ({"a": 1}, None), (True, None),
            (0, _arrow.timestamp("ns")), (2**64 - 1, _arrow.uint64()), (np.float16(1), _arrow.float16()),
            (1, _arrow.decimal128(38, 3)), ("x", _arrow.dictionary(_arrow.int32(), _arrow.string())),
            (1, _arrow.dictionary(_arrow.int32(), _arrow.int64())),
        )
    )  # fmt: skip
    return _arrow.array([value] * rows, kind)


def _zip(content: bytes, rng: Random) -> bytes:
    """Members that are edited, gone, double or of a strange name; a directory at the end that says something else."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = [(name, archive.read(name)) for name in archive.namelist()]
    at = rng.randrange(len(members))
    name, inside = members[at]
    match rng.randrange(6):
        case 0:
            members[at] = (rng.choice(MEMBERS), inside)
        case 1:
            del members[at]
        case 2:
            members.append((name.lower(), _bytes(inside, rng)))
        case _:
            members[at] = (name, _once(name, inside, rng))
    out = io.BytesIO()
    method = rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA))
    with zipfile.ZipFile(out, "w", method) as archive:
        for name, inside in members:
            archive.writestr(zipfile.ZipInfo(name or "x"), inside, method)
    packed = bytearray(out.getvalue())
    if rng.random() < 0.3:
        at = packed.rfind(b"PK\x01\x02")
        packed[at + rng.randrange(4, 46)] = rng.choice((0, 1, 0x7F, 0xFF))
    return bytes(packed)


_EDITS: Mapping[str, Callable[[bytes, Random], bytes]] = {
    ".yaml": _yaml,
    ".json": _json,
    **dict.fromkeys((".urdf", ".xml", ".dae"), _xml),
    **dict.fromkeys((".csv", ".obj", ".stl", ".eds", ".dcf"), _lines),
    ".parquet": _parquet_file,
    ".arrow": _stream,
    ".zip": _zip,
}
