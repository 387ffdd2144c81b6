"""One process data object of a foreign drive: its configuration objects and its bytes (CiA 301, 7.2.2 and 7.5.2.36).

The configuration procedure is enforced: COB-ID (except bit 31), inhibit time, mapped objects and their number change
only while the PDO is invalid, and mapped objects only while their number is 0. If the file makes the COB-ID read-only,
only the number must be 0. The PDO has the sub-indices of the file.
"""

from simulator.drive.dictionary import Abort, AbortCode, Key
from simulator.foreign.checks import NUMBER, check_identifier
from simulator.foreign.dictionary import ForeignDictionary

_INVALID = 1 << 31
_NO_REMOTE = 1 << 30
_CYCLIC, _EVENT = range(1, 241), (254, 255)


class Pdo:
    """Configured by the objects `communication` (1400h.., 1800h..) and `mapping` (1600h.., 1A00h..)."""

    def __init__(self, dictionary: ForeignDictionary, communication: int, mapping: int, *, receive: bool) -> None:
        self._dictionary = dictionary
        self._communication = communication
        self._mapping = mapping
        self._receive = receive
        self.configurable = True  # whether the present NMT state allows configuration
        self._mapped: tuple[Key, ...] | None = None
        self._types = {*_CYCLIC, *_EVENT, dictionary[communication, 2]}  # 0 only if the file has it
        self._switchable = dictionary.writable((communication, 1))
        dictionary.on_download((communication, 1), self._check_cob_id)
        dictionary.on_download((communication, 2), self._check_type)
        dictionary.on_download((communication, 3), lambda _: self._require_changeable())
        dictionary.on_download((communication, 5), lambda _: self._require_configurable())
        dictionary.on_download((mapping, 0), self._check_count)
        for key in dictionary.keys(mapping)[1:]:
            dictionary.on_download(key, self._check_entry)

    @property
    def cob_id(self) -> int:
        """The identifier on the bus."""
        return self._dictionary[self._communication, 1] & NUMBER

    @property
    def valid(self) -> bool:
        """Whether the PDO is in use."""
        return not self._dictionary[self._communication, 1] & _INVALID

    @property
    def transmission_type(self) -> int:
        """0: with a SYNC after a change; 1 to 240: every n-th SYNC; 254, 255: immediately."""
        return self._dictionary[self._communication, 2]

    @property
    def synchronous(self) -> bool:
        return self.transmission_type not in _EVENT

    @property
    def inhibit_time(self) -> float:
        """Shortest time between two event transmissions, s."""
        return self._dictionary.get(self._communication, 3) * 1e-4

    @property
    def event_time(self) -> float:
        """Longest time between two event transmissions, s; 0: unlimited."""
        return self._dictionary.get(self._communication, 5) * 1e-3

    def reset(self) -> None:
        """The dictionary was restored."""
        self._mapped = None

    @property
    def keys(self) -> tuple[Key, ...]:
        """The mapped objects, in their order."""
        if self._mapped is None:
            d = self._dictionary
            self._mapped = tuple(_key(d[self._mapping, sub]) for sub in range(1, d[self._mapping, 0] + 1))
        return self._mapped

    @property
    def entries(self) -> frozenset[Key]:
        """The mapped objects."""
        return frozenset(self.keys)

    @property
    def size(self) -> int:
        """Bytes of the mapped objects."""
        return sum(self._dictionary.bits(key) for key in self.keys) // 8

    def pack(self) -> bytes:
        """The present values of the mapped objects."""
        return b"".join(self._dictionary.encode(key) for key in self.keys)

    def unpack(self, data: bytes) -> list[tuple[Key, bytes]]:
        """The bytes of each mapped object without dummies; `data` has at least `size` bytes."""
        result: list[tuple[Key, bytes]] = []
        start = 0
        for key in self.keys:
            end = start + self._dictionary.bits(key) // 8
            if key in self._dictionary:
                result.append((key, data[start:end]))
            start = end
        return result

    def _check_cob_id(self, value: int) -> None:
        self._require_configurable()
        check_identifier(value & ~(_INVALID | _NO_REMOTE))
        if self.valid and not value & _INVALID and value & NUMBER != self.cob_id:
            raise Abort(AbortCode.STATE)

    def _check_type(self, value: int) -> None:
        self._require_configurable()
        if value not in self._types:
            raise Abort(AbortCode.VALUE)

    def _check_count(self, value: int) -> None:
        self._require_changeable()
        d, total = self._dictionary, 0
        for sub in range(1, value + 1):
            if (self._mapping, sub) not in d:
                raise Abort(AbortCode.PDO_LENGTH)
            entry = d[self._mapping, sub]
            d.check_mapping(_key(entry), entry & 0xFF, receive=self._receive)
            total += entry & 0xFF
        if total > 64:
            raise Abort(AbortCode.PDO_LENGTH)
        self._mapped = None

    def _check_entry(self, value: int) -> None:
        self._require_changeable()
        if self._dictionary[self._mapping, 0] != 0:
            raise Abort(AbortCode.STATE)
        if value:
            self._dictionary.check_mapping(_key(value), value & 0xFF, receive=self._receive)

    def _require_changeable(self) -> None:
        self._require_configurable()
        if self.valid and self._switchable:
            raise Abort(AbortCode.STATE)

    def _require_configurable(self) -> None:
        if not self.configurable:
            raise Abort(AbortCode.STATE)


def process_data(dictionary: ForeignDictionary) -> tuple[list[Pdo], list[Pdo]]:
    """(receive, transmit) PDOs defined by the dictionary."""

    def build(first: int, *, receive: bool) -> list[Pdo]:
        present = [index for index in range(first, first + 0x200) if (index, 1) in dictionary]
        return [Pdo(dictionary, index, index + 0x200, receive=receive) for index in present]

    return build(0x1400, receive=True), build(0x1800, receive=False)


def _key(entry: int) -> Key:
    return entry >> 16, entry >> 8 & 0xFF
