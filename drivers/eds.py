"""Object dictionaries from EDS and DCF files (CiA 306), as the tools of manufacturers write them.

canopen's parser accepts only faultless files. `_cleaned` writes such a file: it decodes the text, keeps the sections
about objects and the device, joins duplicates that agree, writes out compact objects, and completes what CiA 301 and
306 define. What it cannot complete is an error with section and line. Each content is parsed once: a machine has six
drives of one type, and parsing takes 10 ms for `config/eds/virtual-axis.eds`, 60 ms for an EPOS4 file.
"""

import drivers.lean_can  # noqa: F401  # pyright: ignore[reportUnusedImport]

# isort: split
import io
import pickle
import re
from collections.abc import Iterator, Mapping
from configparser import Error as ConfigError
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

import canopen
from canopen.objectdictionary import ODVariable, datatypes
from canopen.objectdictionary.eds import ARR, DOMAIN, RECORD, VAR

from drivers.bounded_yaml import read_bounded

LARGEST = 2**22  # bytes; typical files of manufacturers have 0.1 MB


_OBJECT = re.compile(r"(?:0x)?([0-9A-F]{2,4})(?:\s*sub\s*([0-9A-F]{1,2})|\s*(name|value))?", re.I)


@dataclass(slots=True)
class Section:
    """A section as written: the line of its header, and its values by key in lower case, each with its line."""

    name: str
    line: int
    values: dict[str, tuple[str, int]] = field(default_factory=lambda: {})

    def text(self, key: str) -> str:
        """ "" if the key is missing or empty."""
        return self.values.get(key.lower(), ("", 0))[0]

    def where(self, key: str) -> str:
        line = self.values.get(key.lower(), ("", self.line))[1]
        return f"[{self.name}] line {line}"


def object_dictionary(path: Path, node: int) -> Any:
    """The content of the file as a new `ObjectDictionary`. `node` replaces ``$NODEID``.

    Raises OSError, or ValueError with section, line, value and what to write instead.
    """
    marks = (b"$nodeid", b"devicecom")  # content that depends on the node: ids, or section DeviceComissioning
    content = read_bounded(path, LARGEST)
    own = any(word in content.replace(b"\0", b"").lower() for word in marks)
    return pickle.loads(_parsed(content, path.name, node if own else 1))


def read_sections(path: Path) -> Mapping[str, Section]:
    """The sections of the file by name in lower case. Errors as `object_dictionary`."""
    return _sections(read_bounded(path, LARGEST))


@lru_cache(maxsize=32)
def _parsed(content: bytes, name: str, node: int) -> bytes:
    source = io.StringIO("\n".join(_cleaned(_sections(content))))
    cast(Any, source).name = name  # its suffix selects the format
    try:
        return pickle.dumps(cast(Any, canopen).import_od(source, node))
    except (ConfigError, KeyError) as error:
        raise ValueError(f"not an EDS or DCF: {' '.join(str(error).split())}") from None


def _decoded(content: bytes) -> str:
    """UTF-8 and UTF-16, with or without byte order mark, otherwise Windows-1252."""
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        return content.decode("utf-16", "replace")
    if content.count(b"\0") > len(content) // 4:
        return content.decode("utf-16-le" if content[1:2] == b"\0" else "utf-16-be", "replace")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("cp1252", "replace")


def _sections(content: bytes) -> dict[str, Section]:
    found: dict[str, Section] = {}
    section: Section | None = None
    text = _decoded(content)
    if text.lstrip().startswith("<"):
        raise ValueError("not an EDS or DCF, but XML (XDD, XDC or ESI): have the manufacturer's tool write an EDS")
    for number, line in enumerate(re.split(r"\r\n|\r|\n", text), 1):
        line = line.strip()
        if header := re.match(r"\[([^\]]+)\]", line):
            name = header[1].strip()
            section = found.setdefault(name.lower(), Section(name, number))
        elif (
            section is not None
            and not line.startswith((";", "#"))
            and (pair := re.fullmatch(r"([^=:]+?)\s*[=:]\s*(.*)", line))
        ):
            _add(section, pair[1], re.sub(r"(^|\s+);.*", "", pair[2]).rstrip(), number)
    if not any((match := _OBJECT.fullmatch(name)) and len(match[1]) == 4 for name in found):
        raise ValueError("not an EDS or DCF: has no section of an object, such as [1000] or [6040]")
    return found


def _add(section: Section, name: str, value: str, line: int) -> None:
    """The first value counts, as for Windows. Raises ValueError if a second one contradicts it."""
    compared = {
        "objecttype",
        "datatype",
        "accesstype",
        "defaultvalue",
        "parametervalue",
        "vendornumber",
        "productnumber",
    }
    key = name.lower()
    before, at = section.values.get(key, ("", 0))
    number = _number(value)
    if not before:
        section.values[key] = (value, line)
    elif (
        key in compared and value and value.lower() != before.lower() and (number is None or number != _number(before))
    ):
        raise ValueError(
            f"[{section.name}] line {line}: {name}={value[:40]} contradicts {before[:40]} in line {at}: delete one"
        )


def _number(text: str) -> int | None:
    # decimal, 0x1F or 1Fh; a unit may follow
    pattern = re.compile(r"([+-]?)(?:0x([0-9A-F]+)|([0-9][0-9A-F]*)h|([0-9]+))(?:\s*[\[(%°µ].*|\s+[A-Za-z/].*)?", re.I)
    match = pattern.fullmatch(text.split(";")[0].strip())
    if match is None or len(match[0]) > 40:
        return None
    sign, _, _, plain = match.groups()
    octal = plain is not None and re.fullmatch("0[0-7]+", plain)  # CiA 306: with a leading 0
    digits = "".join(part or "" for part in match.groups()[1:])
    return int(sign + digits, 8 if octal else 10 if plain else 16)


def _value(text: str, signed_bits: int = 0) -> str:
    """An integer as canopen reads it, "" if it is none. Tools write 0xFFFF for -1 in 16 `signed_bits`."""
    pattern = re.compile(r"\$NODEID(?:\s*\+\s*(\S.*))?|(\S.*?)\s*\+\s*\$NODEID", re.I)
    match = pattern.fullmatch(text)
    part = (match[1] or match[2] or "0") if match else text
    number = _number(part)
    if number is None:
        return ""
    if signed_bits and not match and 2 ** (signed_bits - 1) <= number < 2**signed_bits:
        return str(number - 2**signed_bits)
    written = part if re.fullmatch(r"-?(0x[0-9a-fA-F]+|[1-9][0-9]*|0)", part) else str(number)
    return f"$NODEID+{written}" if match else written


def _cleaned(sections: Mapping[str, Section]) -> Iterator[str]:
    """Lines of an EDS that canopen reads."""
    most_objects = 50_000  # a compact object of two lines has up to 255
    objects: dict[int, dict[int | str, Section]] = {}
    for section in sections.values():
        if match := _OBJECT.fullmatch(section.name):
            sub = int(match[2], 16) if match[2] else (match[3] or "").lower()
            objects.setdefault(int(match[1], 16), {}).setdefault(sub, section)
    yield from _about(sections)
    count = 0
    for index, parts in sorted(objects.items()):
        # up to 7: basic types; those between are types of a manufacturer's tool
        for sub, lines in _object(index, parts, objects) if index >= 0x1000 or index <= 7 else ():
            count += 1
            if count > most_objects:
                raise ValueError(f"has more than {most_objects} objects")
            yield f"[{index:04X}{'' if sub is None else f'sub{sub:X}'}]"
            yield from lines


def _about(sections: Mapping[str, Section]) -> Iterator[str]:
    about_numbers = (
        *(f"BaudRate_{rate}" for rate in (10, 20, 50, 125, 250, 500, 800, 1000)),
        "VendorNumber", "ProductNumber", "RevisionNumber", "SimpleBootUpMaster", "SimpleBootUpSlave", "Granularity",
        "DynamicChannelsSupported", "GroupMessaging", "NrOfRXPDO", "NrOfTXPDO", "LSS_Supported",
    )  # fmt: skip
    about = sections.get("deviceinfo", Section("DeviceInfo", 0))
    yield "[DeviceInfo]"
    for keys, read in ((("VendorName", "ProductName", "OrderCode"), str), (about_numbers, _value)):
        yield from (f"{key}={value}" for key in keys if (value := read(about.text(key).strip('"'))))
    for name in ("devicecomissioning", "devicecommissioning"):  # CiA 306 has one m
        if name in sections:
            yield from ("[DeviceComissioning]", f"Baudrate={_number(sections[name].text('Baudrate')) or 0}")
            break
    if "dummyusage" in sections:
        yield "[DummyUsage]"
        yield from (f"Dummy{n:04}={_number(sections['dummyusage'].text(f'Dummy{n:04}')) or 0}" for n in range(1, 8))


def _object(
    index: int, parts: Mapping[int | str, Section], objects: Mapping[int, Mapping[int | str, Section]]
) -> Iterator[tuple[int | None, list[str]]]:
    """The sections of an object: itself (None) and its sub-indices."""
    most_entries = 254  # sub-index 255 describes the object itself (CiA 301)
    own = parts.get("", Section(f"{index:04X}", next(iter(parts.values())).line))
    subs = {sub: section for sub, section in parts.items() if isinstance(sub, int)}
    for section, key in ((own, "CompactSubObj"), *((parts[k], "NrOfEntries") for k in ("name", "value") if k in parts)):
        if (_number(section.text(key)) or 0) > most_entries + 1:  # tools write 255 for "all"
            stated = section.text(key)[:20]
            raise ValueError(f"{section.where(key)}: {key} is {stated}, limit {most_entries}")
    compact = min(_number(own.text("CompactSubObj")) or 0, most_entries)
    text = own.text("ObjectType")
    named = {"": VAR, "VAR": VAR, "ARRAY": ARR, "RECORD": RECORD, "DOMAIN": DOMAIN}
    kind = named.get(text.upper(), _number(text))
    if kind is None:
        raise ValueError(f"{own.where('ObjectType')}: ObjectType={text[:40]} is not a number: 7 is VAR")
    if kind not in (ARR, RECORD) and not compact and not any(subs):
        yield None, [f"ObjectType={kind}", *_variable(index, None, own, kind, objects)]
        return
    name = own.text("ParameterName") or f"{index:04X}h"
    yield None, [f"ObjectType={kind if kind in (ARR, RECORD) else RECORD}", f"ParameterName={name}"]
    if compact and 0 not in subs:
        yield 0, ["ParameterName=Number of entries", "DataType=5", "AccessType=ro", f"DefaultValue={compact}"]
    for sub in range(1, compact + 1):
        if sub not in subs:
            part = Section(own.name, own.line, dict(own.values))
            for title, key in (("name", "parametername"), ("value", "parametervalue")):
                if title in parts and (text := parts[title].text(str(sub))):
                    part.values[key] = (text, own.line)
            yield sub, _variable(index, sub, part, VAR, objects)
    for sub, section in sorted(subs.items()):
        yield sub, _variable(index, sub, section, VAR, objects)


def _variable(
    index: int, sub: int | None, section: Section, kind: int, objects: Mapping[int, Mapping[int | str, Section]]
) -> list[str]:
    names = ("LowLimit", "HighLimit", "DefaultValue", "ParameterValue")
    accesses = ("ro", "wo", "rw", "rwr", "rww", "const")
    data_type = _data_type(index, sub, section, kind, objects)
    access = section.text("AccessType").lower().split(";")[0].strip()
    numeric = data_type in datatypes.INTEGER_TYPES or data_type == datatypes.BOOLEAN
    bits = ODVariable.STRUCT_TYPES[data_type].size * 8 if data_type in datatypes.SIGNED_TYPES else 0
    values = {key: _value(section.text(key), bits) if numeric else section.text(key) for key in names}
    texts = {key: section.text(key) for key in ("ParameterName", "StorageLocation", "Factor", "Description", "Unit")}
    texts["ParameterName"] = texts["ParameterName"] or f"{index:04X}h:{sub or 0:02X}"
    return [
        f"DataType={data_type}",
        f"AccessType={access if access in accesses else 'ro' if sub == 0 else 'rw'}",
        f"PDOMapping={int(bool(_number(section.text('PDOMapping'))))}",
        *(f"{key}={value}" for key, value in {**texts, **values}.items() if value),
    ]


def _data_type(
    index: int, sub: int | None, section: Section, kind: int, objects: Mapping[int, Mapping[int | str, Section]]
) -> int:
    """Missing ones: sub-index 0 is UNSIGNED8 (CiA 301), a DOMAIN is one, objects of the manufacturer are bytes."""
    text = section.text("DataType")
    named = cast(object, vars(datatypes).get(text.upper()))  # "INTEGER32"
    number = named if isinstance(named, int) else _number(text)
    if number is not None and number > 0x1B:  # CANFestival: its own type, whose real one is the default of sub-index 1
        real = objects.get(number, {}).get(1)
        return (_number(real.text("DefaultValue")) if real else None) or datatypes.DOMAIN
    if number:
        return number
    if sub == 0:
        return datatypes.UNSIGNED8
    # the type of a manufacturer's object is needed only where a device map names it
    if kind == DOMAIN or 0x2000 <= index < 0x6000:
        return datatypes.DOMAIN
    what = f"DataType={text[:40]} is not a number" if text else "DataType is missing"
    raise ValueError(
        f"{section.where('DataType')}: {what}: enter that of the manual, for example DataType=0x0004 (INTEGER32)"
    )
