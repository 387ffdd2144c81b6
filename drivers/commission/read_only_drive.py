"""One drive that is only read and never written: each object is read once."""

import drivers.lean_can  # noqa: F401  # pyright: ignore[reportUnusedImport]

# isort: split
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, cast

from canopen.sdo.client import SdoClient

from drivers.canopen.device_map import DeviceMap
from drivers.canopen.objects import Entry
from drivers.canopen.profile import CanopenAxis, CanopenProfile
from drivers.canopen.sdo import ObjectAbsent, Sdo
from drivers.commission.dictionary import Dictionary
from drivers.commission.sheet import Row, Verdict
from drivers.errors import WrongConfiguration

LONG = 4  # bytes
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
        if stated == LONG and wanted < LONG:
            self.long.add(entry)
        return data[:wanted] if stated is None or stated == LONG else data


@dataclass(frozen=True, slots=True)
class Node:
    """One axis under check. Every query raises CommunicationLost if the drive does not answer.

    `_answers`: of the drive so far; `configured` has those that the drive will give once it is configured.
    """

    axis: CanopenAxis
    machine: CanopenProfile
    dictionary: Dictionary
    sdo: ReadOnlySdo
    _answers: dict[Entry, float | WrongConfiguration] = field(default_factory=dict[Entry, float | WrongConfiguration])

    @property
    def map(self) -> DeviceMap:
        return self.machine.device_map

    @property
    def missing(self) -> Mapping[str, str]:
        """Objects that the map lists as missing, and what replaces them."""
        return self.map.missing

    def configured(self) -> "Node":
        """The drive as it will be with the settings of map and manufacturer, on which its units may depend."""
        own = [(setting.entry, float(setting.value)) for setting in self.map.settings]
        makers = [(Entry(m.index, m.sub, m.type, m.name), float(m.value)) for m in self.machine.maker_settings]
        there = {entry: value for entry, value in (*own, *makers) if not isinstance(self.answer(entry), Exception)}
        return Node(self.axis, self.machine, self.dictionary, self.sdo, {**self._answers, **there})

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
        """As `CanopenDevice` reads its units: an object that the map lists as missing counts as 1.
        WrongConfiguration.
        """
        if name in self.missing:
            return 1.0
        found = self.answer(self.map.entry(name))
        if isinstance(found, WrongConfiguration):
            raise found
        return found

    def absent(self, entry: Entry) -> bool:
        return isinstance(self.answer(entry), ObjectAbsent)

    # -- rows ----------------------------------------------------------------------------------------------------

    def row(self, check: str, fits: bool, what: str) -> Row:
        return Row(self.axis.joint, check, Verdict.FITS if fits else Verdict.MISMATCH, what)

    def note(self, check: str, what: str) -> Row:
        return Row(self.axis.joint, check, Verdict.NOTE, what)

    def host(self, check: str, what: str) -> Row:
        return Row(self.axis.joint, check, Verdict.HOST, what)
