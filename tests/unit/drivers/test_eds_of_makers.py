"""EDS and DCF as the tools of manufacturers write them: read as the faultless file, or refused with line and value."""

import re
from pathlib import Path

import pytest

from drivers.commission.drive import DriveDictionary, read_dictionary
from drivers.errors import BadProfile

LINES = (Path(__file__).parents[3] / "config/eds/plain-402.eds").read_text("utf-8").splitlines()
TEXT = "\n".join(LINES)


def read(content: str | bytes, folder: Path) -> DriveDictionary:
    path = folder / "maker.eds"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_dictionary(path, 5)


def dropped(pattern: str) -> str:
    return "\n".join(line for line in LINES if not re.fullmatch(pattern, line))


def section(name: str) -> str:
    return TEXT[TEXT.index(f"[{name}]") :].split("\n\n")[0]


def swapped(name: str, old: str, new: str) -> str:
    """`old` replaced in one section."""
    assert re.search(old, section(name)), name
    return TEXT.replace(section(name), re.sub(old, new, section(name)))


UMLAUT = TEXT.replace("VendorName=", "VendorName=Müller ")
SAME = {
    "cp1252": UMLAUT.encode("cp1252"),
    "utf-8 with BOM": UMLAUT.encode("utf-8-sig"),
    "utf-16 little": UMLAUT.encode("utf-16"),
    "utf-16 big": b"\xfe\xff" + UMLAUT.encode("utf-16-be"),
    "utf-16 without BOM": UMLAUT.encode("utf-16-le"),
    "CR LF": TEXT.replace("\n", "\r\n"),
    "CR": TEXT.replace("\n", "\r"),
    "NodeID in small letters": TEXT.replace("$NODEID+", "$NodeID + "),
    "PDOMapping empty": TEXT.replace("PDOMapping=0", "PDOMapping="),
    "DataType of sub-index 0 missing": re.sub(r"(sub0\](?:\n.+)*?)\nDataType=.*", r"\1", TEXT),
    "ObjectType missing": dropped("ObjectType=(0x)?7"),
    "text in FileInfo": TEXT.replace("[FileInfo]", "[FileInfo]\nmade by a tool"),
    "text before the first section": "a file\n" + TEXT,
    "comments with a wrong count": TEXT + "\n[Comments]\nLines=3\nLine1=a\n",
    "dummies incomplete": dropped("Dummy000[1-4].*"),
    "lists empty": TEXT + "\n[ManufacturerObjects]\nSupportedObjects=\n[Tools]\nItems=x\n",
    "keys in capitals": re.sub(r"^\w+=", lambda key: key[0].upper(), TEXT, flags=re.M),
    "sections in small letters": re.sub(r"^\[.*\]", lambda name: name[0].lower(), TEXT, flags=re.M),
    "blanks": TEXT.replace("=", " = ").replace("\n", "\n  "),
    "comments behind values": re.sub(r"^((?:Data|Object|Access)Type=.*)", r"\1 ; CiA 301", TEXT, flags=re.M),
    "decimal": re.sub(r"=(0x[0-9A-Fa-f]+)$", lambda value: f"={int(value[1], 16)}", TEXT, flags=re.M),
    "hexadecimal with h": re.sub(r"=0x([0-9A-Fa-f]+)$", r"=0\1h", TEXT, flags=re.M),
    "octal zero": re.sub(r"^DataType=(?:0x)?0*([1-7])$", r"DataType=0\1", TEXT, flags=re.M),
    "units": re.sub(r"^(DefaultValue=\d+)$", r"\1 [inc]", TEXT, flags=re.M),
    "twice": TEXT + "\n" + section("6064").replace("0x0004", "4") + "\n" + section("607Dsub1"),
    "names of objects missing": dropped("ParameterName=.*"),
    "sub-index before its object": section("607Dsub1") + "\n\n" + TEXT,
    "object of sub-indices missing": TEXT.replace(section("607D"), ""),
    "DataType of an own object": TEXT + "\n[2345]\nParameterName=x\nDataType=INTEGER\n",
    "values of the file": TEXT + "\n[DeviceCommissioning]\nBaudrate=500 kbit/s\nNodeID=0x5\n",
}


@pytest.mark.parametrize("content", SAME.values(), ids=SAME)
def test_what_a_tool_writes_otherwise_says_the_same(content: str | bytes, tmp_path: Path) -> None:
    expected, found = read(TEXT, tmp_path), read(content, tmp_path)
    assert {key: value for key, value in found.objects.items() if key != (0x2345, 0)} == expected.objects
    assert (found.vendor, found.product, found.revision) == (expected.vendor, expected.product, expected.revision)
    assert found.name == ("Müller " if isinstance(content, bytes) else "") + expected.name


REFUSED = {
    "type is no number": (
        swapped("6064", "DataType=.*", "DataType=INTEGER32"),
        r"\[6064\] line \d+: DataType=INTEGER32 is not a",
    ),
    "type missing": (
        swapped("6064", "DataType=.*\n", ""),
        r"\[6064\] line \d+: DataType is missing: enter that of the man",
    ),
    "two types": (
        TEXT + "\n[6064]\nDataType=3\n",
        r"\[6064\] line \d+: DataType=3 contradicts 0x0004 in line \d+: delete",
    ),
    "header cut": (TEXT.replace("[6064]", "[6064"), r"\] line \d+: \w+=.* contradicts .* in line \d+: delete one"),
    "object type": (
        swapped("6064", "ObjectType=.*", "ObjectType=VAR"),
        r"\[6064\] line \d+: ObjectType=VAR is not a number",
    ),
    "XML": (
        '<?xml version="1.0"?><ISO15745ProfileContainer/>',
        "but XML .*: have the manufacturer's tool write an EDS",
    ),
    "no object": ("[FileInfo]\nFileName=x\n", "not an EDS or DCF: has no section of an object"),
    "bytes": (bytes(range(256)) * 9, "not an EDS or DCF"),
    "empty": ("", "not an EDS or DCF"),
}


@pytest.mark.parametrize(("content", "told"), REFUSED.values(), ids=REFUSED)
def test_what_cannot_be_read_is_refused_with_its_line(content: str | bytes, told: str, tmp_path: Path) -> None:
    with pytest.raises(BadProfile, match=rf"maker\.eds: .*{told}") as refused:
        read(content, tmp_path)
    if match := re.search(r"\[(\w+)\] line (\d+)", str(refused.value)):
        assert isinstance(content, str)
        assert match[1] in "\n".join(content.splitlines()[: int(match[2])])


def test_compact_objects_have_all_their_entries(tmp_path: Path) -> None:
    compact = (
        "[607D]\nParameterName=Limits\nObjectType=0x8\nDataType=0x0004\nAccessType=rw\nCompactSubObj=2\n"
        "DefaultValue=-7\n[607DName]\nNrOfEntries=1\n1=Min\n[607DValue]\nNrOfEntries=1\n2=0x10\n"
    )
    objects = read(re.sub(r"\[607D\w*\](\n.+)*", "", TEXT) + "\n" + compact, tmp_path).objects
    expected = read(TEXT, tmp_path).objects
    assert objects.keys() == expected.keys()
    assert [(objects[0x607D, sub].type, objects[0x607D, sub].value) for sub in (0, 1, 2)] == [
        ("u8", 2),
        ("i32", -7),
        ("i32", 16),
    ]


@pytest.mark.parametrize(
    ("written", "value"),
    [
        ("$NODEID+0x180", 0x185), ("0x180+$NODEID", 0x185), ("$nodeid + 384", 0x185), ("$NODEID", 5), ("0x10", 16),
        ("10", 10), ("010", 8), ("08", 8), ("10h", 16), ("10 ; ms", 10), ("10;ms", 10), ("10 [ms]", 10), ("10 %", 10),
        ("0x10 rpm", 16), ("-3", -3), ("", None), ("ten", None), ("1.5", None), ("1,5", None), ("$NODEID+x", None),
        ("9" * 5000, None),
    ],
)  # fmt: skip
def test_values_in_every_notation(written: str, value: int | None, tmp_path: Path) -> None:
    added = f"\n[2345]\nParameterName=x\nDataType=7\nAccessType=rw\nDefaultValue={written}\n"
    assert read(TEXT + added, tmp_path).value(0x2345) == value


def test_a_file_cut_anywhere_is_read_or_refused(tmp_path: Path) -> None:
    for end in range(0, len(TEXT), 211):
        for content in (TEXT[:end], TEXT[end:]):
            try:
                read(content, tmp_path)
            except BadProfile as error:
                assert "line" in str(error) or "not an EDS or DCF" in str(error)  # noqa: PT017


@pytest.mark.parametrize("key", ["VendorNumber", "ProductNumber", "RevisionNumber"])
def test_an_identity_of_zero_is_unknown(key: str, tmp_path: Path) -> None:
    found = read(re.sub(rf"{key}=.*", f"{key}=0x00000000", TEXT), tmp_path)
    stated = {"VendorNumber": found.vendor, "ProductNumber": found.product, "RevisionNumber": found.revision}
    assert stated[key] != 0
