"""One drive under check: what its EDS or DCF (CiA 306) says, what it answers, and the sheet of what was found.

A drive is only read and never written, and each object is read once.
"""

import drivers.lean_can  # noqa: F401  # pyright: ignore[reportUnusedImport]

# isort: split
import json
import struct
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from enum import Enum
from pathlib import Path
from typing import Any, cast

from canopen.objectdictionary import ODVariable, datatypes
from canopen.sdo.client import SdoClient

from drivers.canopen.profile import CanopenAxis, CanopenProfile, DeviceMap, Entry
from drivers.canopen.sdo import ObjectAbsent, Sdo
from drivers.eds import object_dictionary
from drivers.errors import BadProfile, WrongConfiguration

Key = tuple[int, int]

_TYPE_NAMES = {
    datatypes.INTEGER8: "i8",
    datatypes.UNSIGNED8: "u8",
    datatypes.INTEGER16: "i16",
    datatypes.UNSIGNED16: "u16",
    datatypes.INTEGER32: "i32",
    datatypes.UNSIGNED32: "u32",
}


@dataclass(frozen=True, slots=True)
class ListedObject:
    """One object. `type` as in device maps ("i32"), "" for other types; `value` as commissioned, otherwise the
    default.
    """

    type: str
    writable: bool
    mappable: bool
    value: int | None


@dataclass(frozen=True, slots=True)
class DriveDictionary:
    """The objects of a file by index and sub-index, and the manufacturer of the drive; None if the file does not state
    it, or states 0 or FFFFFFFFh as templates do.
    """

    objects: Mapping[Key, ListedObject]
    vendor: int | None
    product: int | None
    revision: int | None
    name: str  # of maker and product, for people

    def value(self, index: int, sub: int = 0) -> int | None:
        """Value of an object according to the file."""
        listed = self.objects.get((index, sub))
        return None if listed is None else listed.value


def read_dictionary(path: Path, node: int) -> DriveDictionary:
    """BadProfile names the file and the reason. `node` resolves ``$NODEID``."""
    try:
        whole: Any = object_dictionary(path, node)
    except (OSError, ValueError) as error:
        raise BadProfile(f"eds: {path}: {getattr(error, 'strerror', None) or error}") from None
    objects: dict[Key, ListedObject] = {}
    for entry in whole.values():
        for variable in [entry] if isinstance(entry, ODVariable) else entry.values():
            objects[variable.index, variable.subindex] = _described(variable)
    about = whole.device_information
    numbers = enumerate((about.vendor_number, about.product_number, about.revision_number), 1)
    both = [(number, objects.get((0x1018, sub))) for sub, number in numbers]
    vendor, product, revision = (
        next((value for value in (number, listed and listed.value) if value not in (None, 0, 0xFFFFFFFF)), None)
        for number, listed in both
    )
    name = _printable(f"{about.vendor_name or ''} {about.product_name or ''}")
    return DriveDictionary(objects, vendor, product, revision, name)


def _printable(name: str) -> str:
    """In one line, without characters that YAML does not read."""
    return " ".join("".join(letter if letter.isprintable() else " " for letter in name).split())


def _described(variable: Any) -> ListedObject:
    values = (getattr(variable, "value", None), variable.default)
    value = next((each for each in values if isinstance(each, int)), None)
    return ListedObject(_TYPE_NAMES.get(variable.data_type, ""), variable.writable, variable.pdo_mappable, value)


class CheckVerdict(Enum):
    """Meaning of a row for the person who signs."""

    FITS = "fits"
    HOST = "host"  # missing in the drive: the host, or what the map names, replaces it
    NOTE = "note"  # not determined, or for information
    MISMATCH = "MISMATCH"


@dataclass(frozen=True, slots=True)
class CheckRow:
    """One item of the check. `check` is a permanent name; `what` is a sentence with values and limits."""

    joint: str  # "": the whole machine
    check: str
    verdict: CheckVerdict
    what: str


@dataclass(frozen=True, slots=True)
class CheckSheet:
    """One check of one machine. `files`: SHA-256 of the files used."""

    profile: str
    made: str  # time, ISO 8601
    files: dict[str, str]
    excitation: dict[str, str]  # by joint
    rows: tuple[CheckRow, ...]
    energy: str = "without energy"

    @property
    def mismatches(self) -> tuple[CheckRow, ...]:
        return tuple(row for row in self.rows if row.verdict is CheckVerdict.MISMATCH)

    def with_rows(self, rows: Iterable[CheckRow], energy: str = "without energy") -> "CheckSheet":
        """The sheet with further rows."""
        return replace(self, rows=(*self.rows, *rows), energy=energy)

    def json(self) -> str:
        """The sheet as one document, `sound` first."""
        rows = [asdict(row) | {"verdict": row.verdict.value} for row in self.rows]
        return json.dumps({"sound": not self.mismatches} | asdict(self) | {"rows": rows}, indent=2)

    def text(self) -> str:
        """A table in plain text, the duties of the host, the mismatches again, and the line to sign."""
        lines = [f"Check of {self.profile} at {self.made}, {self.energy}", ""]
        lines += [f"{name}  SHA-256 {digest}" for name, digest in self.files.items()]
        lines += ["", *_table(self.rows)]
        lines += ["", *(f"{joint}: set-points by {way}" for joint, way in self.excitation.items())]
        lines += _listed("The host, not the drive:", (row for row in self.rows if row.verdict is CheckVerdict.HOST))
        lines += _listed(f"Mismatches: {len(self.mismatches) or 'none'}", self.mismatches)
        end = (
            "NOT fit for motion: correct the mismatches and check again" if self.mismatches else "Fit for a first move"
        )
        return "\n".join(
            [*lines, "", end, "", "Checked by ____________________  Date ____________  Signature ____________________"]
        )


def _listed(title: str, rows: Iterable[CheckRow]) -> list[str]:
    """Sentences under a title; a sentence that applies to several joints is printed once."""
    joints = Counter[tuple[str, str]]()
    names: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        joints[row.check, row.what] += 1
        names.setdefault((row.check, row.what), []).append(row.joint or "machine")
    return ["", title, *(f"  {', '.join(names[key])}: {key[0]}: {key[1]}" for key in joints)]


def _table(rows: tuple[CheckRow, ...]) -> list[str]:
    titles = ("axis", "check", "verdict", "what")
    cells = [(row.joint or "machine", row.check, row.verdict.value, row.what) for row in rows]
    widths = [max(map(len, column)) for column in zip(titles, *cells, strict=True)][:3]
    return [
        "  ".join([*(cell.ljust(width) for cell, width in zip(line, widths, strict=False)), line[3]])
        for line in (titles, *cells)
    ]


COMMANDS = {  # objects that energise or move: controlword, mode, targets, offsets
    (0x6040, 0), (0x6060, 0), (0x6071, 0), (0x607A, 0), (0x60B0, 0), (0x60B1, 0), (0x60B2, 0), (0x60C1, 1), (0x60FF, 0),
}  # fmt: skip


class ReadOnlySdo(Sdo):
    """An SDO client that refuses to write: what a check changes would be what the next check judges.

    Its `client` has no dictionary, because that would shorten an answer that is too long; `long`: answers of 4
    bytes.
    """

    def __init__(self, client: SdoClient, place: str, check_alive: Callable[[], None]) -> None:
        super().__init__(client, place, check_alive)
        self.long: set[Entry] = set()

    def write(self, entry: Entry, value: float) -> None:
        """Raises WrongConfiguration."""
        raise WrongConfiguration(f"{self.place}: {entry} = {value:g}: a check writes nothing")

    def _answer(self, entry: Entry) -> bytes:
        """Length as the drive states it; otherwise the length of the type. Some drives always send 4 bytes."""
        wanted = struct.calcsize("<" + entry.type)
        with cast(Any, self.client).open(entry.index, entry.sub, buffering=0) as stream:
            stated, data = cast("int | None", stream.size), cast(bytes, stream.read())
        if stated == 4 and wanted < 4:
            self.long.add(entry)
        return data[:wanted] if stated is None or stated == 4 else data


@dataclass(frozen=True, slots=True)
class CheckedNode:
    """One axis under check. Every query raises CommunicationLost if the drive does not answer.

    `_answers`: of the drive so far; `configured` has those that the drive will give once it is configured.
    """

    axis: CanopenAxis
    machine: CanopenProfile
    dictionary: DriveDictionary
    sdo: ReadOnlySdo
    _answers: dict[Entry, float | WrongConfiguration] = field(default_factory=dict[Entry, float | WrongConfiguration])

    @property
    def map(self) -> DeviceMap:
        return self.machine.device_map

    @property
    def missing(self) -> Mapping[str, str]:
        """Objects that the map lists as missing, and what replaces them."""
        return self.map.missing

    def configured(self) -> "CheckedNode":
        """The drive as it will be with the settings of map and manufacturer, on which its units may depend."""
        own = [(setting.entry, float(setting.value)) for setting in self.map.settings]
        makers = [(Entry(m.index, m.sub, m.type, m.name), float(m.value)) for m in self.machine.maker_settings]
        there = {entry: value for entry, value in (*own, *makers) if not isinstance(self.answer(entry), Exception)}
        return CheckedNode(self.axis, self.machine, self.dictionary, self.sdo, {**self._answers, **there})

    def answer(self, entry: Entry) -> float | WrongConfiguration:
        """The value, or the error why there is none."""
        if entry not in self._answers:
            try:
                self._answers[entry] = self.sdo.read(entry)
            except WrongConfiguration as error:
                self._answers[entry] = error
        return self._answers[entry]

    def value(self, entry: Entry) -> int | None:
        """The value; None if there is none."""
        found = self.answer(entry)
        return None if isinstance(found, WrongConfiguration) else int(found)

    def listed(self, entry: Entry) -> int | None:
        """The value of an object that is in no map; read only if the EDS has it."""
        return self.value(entry) if (entry.index, entry.sub) in self.dictionary.objects else None

    def of_map(self, name: str) -> int | None:
        """The value of an object of the map; None if it is missing."""
        return None if name in self.missing else self.value(self.map.entry(name))

    def read(self, name: str) -> float:
        """As `CanopenDevice` reads its units: what the map lists as missing counts as 1. WrongConfiguration."""
        if name in self.missing:
            return 1.0
        found = self.answer(self.map.entry(name))
        if isinstance(found, WrongConfiguration):
            raise found
        return found

    def absent(self, entry: Entry) -> bool:
        return isinstance(self.answer(entry), ObjectAbsent)

    # -- rows ----------------------------------------------------------------------------------------------------

    def row(self, check: str, fits: bool, what: str) -> CheckRow:
        return CheckRow(self.axis.joint, check, CheckVerdict.FITS if fits else CheckVerdict.MISMATCH, what)

    def note(self, check: str, what: str) -> CheckRow:
        return CheckRow(self.axis.joint, check, CheckVerdict.NOTE, what)

    def host(self, check: str, what: str) -> CheckRow:
        return CheckRow(self.axis.joint, check, CheckVerdict.HOST, what)
