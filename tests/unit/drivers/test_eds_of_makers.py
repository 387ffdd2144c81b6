"""EDS and DCF as the tools of manufacturers write them: read as the faultless file, or refused with line and value."""

import re
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
import yaml
from hypothesis import HealthCheck, given, settings, strategies as st

from drivers.commission.draft import map_text, profile_text, shortcomings
from drivers.commission.drive import DriveDictionary, read_dictionary
from drivers.errors import BadProfile

LINES = (Path(__file__).parents[3] / "config/eds/plain-402.eds").read_text("utf-8").splitlines()
TEXT = "\n".join(LINES)
MANY = settings(deadline=None, max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])


def read(content: str | bytes, folder: Path) -> DriveDictionary:
    path = folder / "maker.eds"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_dictionary(path, 5)


def section(name: str, text: str = TEXT) -> str:
    found = re.search(rf"^ *\[{name}\](?:\n *[^\s\[].*)*", text, re.I | re.M)
    assert found, name
    return found[0]


def swapped(name: str, old: str, new: str) -> str:
    """`old` replaced in one section."""
    assert re.search(old, section(name)), name
    return TEXT.replace(section(name), re.sub(old, new, section(name)))


def without(*names: str) -> str:
    """The file without these objects."""
    return re.sub(rf"\[(?:{'|'.join(names)})(?:sub\w+)?\](?:\n.+)*", "", TEXT)


def lines(pattern: str, new: str | Callable[[re.Match[str]], str]) -> Callable[[str], str]:
    """Exchanges what `pattern` finds; ^ and $ are the ends of a line."""
    return lambda text: re.sub(pattern, new, text, flags=re.M)


def typed(text: str) -> str:
    names = {
        "2": "INTEGER8",
        "3": "Integer16",
        "4": "integer32",
        "5": "UNSIGNED8",
        "6": "UNSIGNED16",
        "7": "UNSIGNED32",
    }
    named = lines(r"^DataType=(?:0x)?0*([2-7])$", lambda found: f"DataType={names[found[1]]}")(text)
    return lines("^ObjectType=(0x)?7$", "ObjectType=VAR ; 7")(lines("^ObjectType=(0x)?8$", "ObjectType=ARRAY")(named))


SAME: dict[str, Callable[[str], str]] = {
    "NodeID in small letters": lambda text: text.replace("$NODEID+", "$NodeID + "),
    "NodeID behind": lines(r"\$NODEID\+(\w+)", r"\1+$NODEID"),
    "PDOMapping empty": lines("^PDOMapping=0$", "PDOMapping="),
    "limits empty": lines(r"^(LowLimit|HighLimit)=.*", r"\1="),
    "DataType of sub-index 0 missing": lines(r"(sub0\](?:\n.+)*?)\nDataType=.*", r"\1"),
    "ObjectType missing": lines("^ObjectType=(0x)?7\n", ""),
    "types by name": typed,
    "ParameterValue of a DCF": lines(r"^DefaultValue=(.+)$", r"DefaultValue=0\nParameterValue=\1"),
    "text in FileInfo": lambda text: text.replace("[FileInfo]", "[FileInfo]\nmade by a tool"),
    "text before the first section": lambda text: "a file\n" + text,
    "comments with a wrong count": lambda text: text + "\n[Comments]\nLines=3\nLine1=a\n",
    "dummies incomplete": lines("^Dummy000[1-4].*\n", ""),
    "lists empty": lambda text: text + "\n[ManufacturerObjects]\nSupportedObjects=\n[Tools]\nItems=x\n",
    "list with a wrong count": lines("^SupportedObjects=.*", "SupportedObjects=0x91"),
    "keys in capitals": lines(r"^\w+=", lambda key: key[0].upper()),
    "sections in small letters": lines(r"^\[.*\]", lambda name: name[0].lower()),
    "access in capitals": lines(r"^AccessType=.*", lambda line: line[0].upper()),
    "blanks": lambda text: text.replace("=", " = ").replace("\n", "\n  "),
    "comments behind values": lines(r"^((?:Data|Object|Access)Type=\w+)$", r"\1 ; CiA 301"),
    "comments between lines": lines(r"^DataType=", ";StorageLocation=RAM\nDataType="),
    "decimal": lines(r"=(0x[0-9A-Fa-f]+)$", lambda value: f"={int(value[1], 16)}"),
    "hexadecimal": lines(r"=([1-9][0-9]*)$", lambda value: f"=0x{int(value[1]):X}"),
    "hexadecimal with h": lines(r"=0x([0-9A-Fa-f]+)$", r"=0\1h"),
    "octal zero": lines(r"^DataType=(?:0x)?0*([1-7])$", r"DataType=0\1"),
    "units": lines(r"^(DefaultValue=\d+)$", r"\1 [inc]"),
    "twice": lambda text: f"{text}\n\n{section('6064', text).replace('0x0004', '4')}\n{section('607Dsub1', text)}\n\n",
    "names in quotes": lines(r"^((?:Vendor|Product)Name)=(.*)", r'\1="\2"'),
    "names of objects missing": lines("^ParameterName=.*\n", ""),
    "keys of other tools": lines(r"^SubNumber=", "1_Sub0=4\nObjFlags=0x0\nSubNumber="),
    "sub-index before its object": lambda text: section("607Dsub1", text) + "\n\n" + text,
    "object of sub-indices missing": lambda text: text.replace(section("607D", text), ""),
    "DataType of an own object": lambda text: text + "\n[2345]\nParameterName=x\nDataType=OTHER\n",
    "values of the file": lambda text: text + "\n[DeviceCommissioning]\nBaudrate=500 kbit/s\nNodeID=0x5\n",
}
ENCODED: dict[str, Callable[[str], bytes]] = {
    "utf-8": str.encode,
    "cp1252": lambda text: text.encode("cp1252"),
    "utf-8 with BOM": lambda text: text.encode("utf-8-sig"),
    "utf-16 little": lambda text: text.encode("utf-16"),
    "utf-16 big": lambda text: b"\xfe\xff" + text.encode("utf-16-be"),
    "utf-16 without BOM": lambda text: text.encode("utf-16-le"),
    "CR LF": lambda text: text.replace("\n", "\r\n").encode(),
    "CR": lambda text: text.replace("\n", "\r").encode(),
}


def says_the_same(changes: Sequence[str], encoding: str, folder: Path) -> None:
    text = TEXT.replace("VendorName=", "VendorName=Müller ")
    for change in changes:
        text = SAME[change](text)
    expected, found = read(TEXT, folder), read(ENCODED[encoding](text), folder)
    assert {key: value for key, value in found.objects.items() if key != (0x2345, 0)} == expected.objects
    assert (found.vendor, found.product, found.revision) == (expected.vendor, expected.product, expected.revision)
    assert found.name == f"Müller {expected.name}"


@pytest.mark.parametrize(
    ("change", "encoding"), [*((each, "utf-8") for each in SAME), *(("units", e) for e in ENCODED)]
)
def test_what_a_tool_writes_otherwise_says_the_same(change: str, encoding: str, tmp_path: Path) -> None:
    assert SAME[change](TEXT) != TEXT
    says_the_same([change], encoding, tmp_path)


@MANY
@given(st.lists(st.sampled_from([*SAME]), min_size=2, max_size=6, unique=True), st.sampled_from([*ENCODED]))
def test_several_habits_of_a_tool_say_the_same(tmp_path: Path, changes: list[str], encoding: str) -> None:
    says_the_same(changes, encoding, tmp_path)


REFUSED = {
    "type is no number": (
        swapped("6064", "DataType=.*", "DataType=SIGNED_TYPES"),
        r"\[6064\] line \d+: DataType=SIGNED_TYPES is not a",
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
        swapped("6064", "ObjectType=.*", "ObjectType=VARIABLE"),
        r"\[6064\] line \d+: ObjectType=VARIABLE is not a number",
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


@pytest.mark.parametrize(("written", "entries"), [("2", 2), ("255", 254)])
def test_compact_objects_have_all_their_entries(written: str, entries: int, tmp_path: Path) -> None:
    compact = (
        f"[607D]\nParameterName=Limits\nObjectType=0x8\nDataType=0x0004\nAccessType=rw\nCompactSubObj={written}\n"
        "DefaultValue=-7\n[607DName]\nNrOfEntries=1\n1=Min\n[607DValue]\nNrOfEntries=1\n2=0x10\n"
    )
    objects = read(f"{without('607D')}\n{compact}", tmp_path).objects
    found = [(sub, each.type, each.value) for (index, sub), each in objects.items() if index == 0x607D]
    assert found[:3] == [(0, "u8", entries), (1, "i32", -7), (2, "i32", 16)]
    assert len(found) == entries + 1


@pytest.mark.parametrize(
    ("written", "value"),
    [
        ("$NODEID+0x180", 0x185), ("0x180+$NODEID", 0x185), ("$nodeid + 384", 0x185), ("$NODEID", 5), ("0x10", 16),
        ("10", 10), ("010", 8), ("08", 8), ("10h", 16), ("10 ; ms", 10), ("10;ms", 10), ("10 [ms]", 10), ("10 %", 10),
        ("0x10 rpm", 16), ("-3", -3), ("", None), ("ten", None), ("1.5", None), ("1,5", None), ("$NODEID+x", None),
        ("9" * 5000, None), ("0x80000000", -(2**31)), ("4294967295", -1), ("0x7FFFFFFF", 2**31 - 1),
        ("$NODEID+0x80000180", 0x80000185),
    ],
)  # fmt: skip
def test_values_in_every_notation(written: str, value: int | None, tmp_path: Path) -> None:
    added = f"\n[2345]\nParameterName=x\nDataType=4\nAccessType=rw\nDefaultValue={written}\n"
    assert read(TEXT + added, tmp_path).value(0x2345) == value


@MANY
@given(
    st.lists(
        st.tuples(
            st.integers(0, len(LINES) - 1),
            st.sampled_from(["", "[6064", "[6064]", "[]", "=", "DataType=", "DataType=9", "ObjectType=8", "\0"])
            | st.text(max_size=12),
            st.sampled_from([0, 1, 40]),  # number of lines that it replaces
        ),
        min_size=1,
        max_size=4,
    )
)
def test_a_damaged_file_is_read_or_refused_in_one_sentence(tmp_path: Path, damages: list[tuple[int, str, int]]) -> None:
    content = [*LINES]
    for at, new, replaced in damages:
        content[at : at + replaced] = [new]
    try:
        found = read("\n".join(content).encode("utf-8", "replace"), tmp_path)
    except BadProfile as error:
        assert re.search(r"\] line \d+: |not an EDS or DCF|has more than", str(error))  # noqa: PT017
        assert "\n" not in str(error)  # noqa: PT017
    else:
        yaml.safe_load(map_text(found))
        yaml.safe_load(profile_text(found, ["a"], "x.eds", "y.yaml", None))


@pytest.mark.parametrize("number", ["0x00000000", "0xFFFFFFFF"])
@pytest.mark.parametrize(("key", "sub"), [("Vendor", 1), ("Product", 2), ("Revision", 3)])
def test_an_identity_of_a_template_is_unknown(key: str, sub: int, number: str, tmp_path: Path) -> None:
    text = re.sub(rf"{key}Number=.*", f"{key}Number={number}", TEXT)
    plain = read(TEXT, tmp_path)
    for content, known in ((text, plain.value(0x1018, sub)), (text.replace(section(f"1018sub{sub}"), ""), None)):
        found = read(content, tmp_path)
        assert {"Vendor": found.vendor, "Product": found.product, "Revision": found.revision}[key] == known


@pytest.mark.parametrize(
    ("missing", "told"),
    [
        ((), []),
        (  # SINAMICS S120
            ("6064", "607A"),
            [
                "not in the file: 6064h, 607Ah; without these the drive cannot be used",
                "excitation that remains: 60FFh (cyclic_velocity)",
            ],
        ),
        (
            ("6077",),
            [
                "without 6077h or 6078h the drive cannot be used",
                "excitation that remains: 60FFh (cyclic_velocity), 607Ah (cyclic_position)",
            ],
        ),
        (("60FF", "607A"), ["not in the file: 607Ah; without these the drive cannot be used", "no excitation remains"]),
    ],
    ids=["nothing", "S120", "torque", "set-points"],
)
def test_what_a_drive_lacks_is_told_with_the_excitation_that_remains(
    missing: tuple[str, ...], told: list[str], tmp_path: Path
) -> None:
    content = without(*missing) if missing else TEXT
    found = shortcomings(read(re.sub(r"(\[6502\](?:\n.+)*\n)DefaultValue=.*", r"\1", content), tmp_path))
    assert len(found) == len(told)
    assert all(sentence.startswith(start) for sentence, start in zip(found, told, strict=True))
