"""One process data object: its configuration objects and its bytes (CiA 301, 7.2.2)."""

import struct

from simulator.drive.dictionary import Abort, AbortCode, Dictionary, Key

_INVALID = 1 << 31
_ID = 0x7FF


class Pdo:
    """Configured by the objects `communication` (1400h.., 1800h..) and `mapping` (1600h.., 1A00h..).

    The configuration procedure is enforced: while the PDO is valid, only bit 31 of its COB-ID and its type may
    change; entries may change only while their number is 0.
    """

    def __init__(self, dictionary: Dictionary, communication: int, mapping: int, *, receive: bool) -> None:
        self._dictionary = dictionary
        self._communication = communication
        self._mapping = mapping
        self._receive = receive
        self._compiled: tuple[struct.Struct, list[Key]] | None = None
        dictionary.on_download((communication, 1), self._check_cob_id)
        dictionary.on_download((communication, 2), self._check_type)
        dictionary.on_download((mapping, 0), self._check_count)
        for key in dictionary.keys(mapping)[1:]:
            dictionary.on_download(key, self._check_entry)

    def reset(self) -> None:
        """The dictionary was restored."""
        self._compiled = None

    @property
    def cob_id(self) -> int:
        """The identifier on the bus."""
        return self._dictionary[self._communication, 1] & _ID

    @property
    def valid(self) -> bool:
        """Whether the PDO is in use."""
        return not self._dictionary[self._communication, 1] & _INVALID

    @property
    def transmission_type(self) -> int:
        """1 to 240: every n-th SYNC; 254, 255: immediately."""
        return self._dictionary[self._communication, 2]

    def pack(self) -> bytes:
        """The present values of the mapped objects."""
        layout, keys = self._layout()
        return layout.pack(*[self._dictionary[key] for key in keys])

    def unpack(self, data: bytes) -> list[tuple[Key, bytes]]:
        """The bytes of each mapped object; empty if the frame is too short."""
        layout, keys = self._layout()
        if len(data) < layout.size:
            return []
        result: list[tuple[Key, bytes]] = []
        start = 0
        for key in keys:
            size = _bits(self._dictionary, key) // 8
            result.append((key, data[start : start + size]))
            start += size
        return result

    def _layout(self) -> tuple[struct.Struct, list[Key]]:
        if self._compiled is None:
            count = self._dictionary[self._mapping, 0]
            keys = [_key(self._dictionary[self._mapping, sub]) for sub in range(1, count + 1)]
            self._compiled = struct.Struct("<" + "".join(self._dictionary.struct_format(key) for key in keys)), keys
        return self._compiled

    def _check_cob_id(self, value: int) -> None:
        if value & _INVALID:
            return
        if self.valid and value & _ID != self.cob_id:
            raise Abort(AbortCode.STATE)
        if value & 0x3FFFFFFF & ~_ID or not 0x180 < value & _ID < 0x580:
            raise Abort(AbortCode.VALUE)  # extended or reserved identifiers

    def _check_type(self, value: int) -> None:
        if value == 0 or 240 < value < 254:
            raise Abort(AbortCode.VALUE)

    def _check_count(self, value: int) -> None:
        self._require_invalid()
        total = 0
        for sub in range(1, value + 1):
            key = _key(self._dictionary[self._mapping, sub])
            if self._dictionary.mapping(key) is None:
                raise Abort(AbortCode.NO_OBJECT)
            total += _bits(self._dictionary, key)
        if total > 64:
            raise Abort(AbortCode.PDO_LENGTH)
        self._compiled = None

    def _check_entry(self, value: int) -> None:
        self._require_invalid()
        if self._dictionary[self._mapping, 0] != 0:
            raise Abort(AbortCode.STATE)
        if value == 0:
            return
        rule = self._dictionary.mapping(_key(value))
        if rule is None:
            raise Abort(AbortCode.NO_OBJECT)
        bits, writable, readable = rule
        if value & 0xFF != bits or not (writable if self._receive else readable):
            raise Abort(AbortCode.NOT_MAPPABLE)

    def _require_invalid(self) -> None:
        if self.valid:
            raise Abort(AbortCode.STATE)


def process_data(dictionary: Dictionary) -> tuple[list[Pdo], list[Pdo]]:
    """(receive, transmit) PDOs defined by the dictionary."""

    def build(first: int, *, receive: bool) -> list[Pdo]:
        present = [index for index in range(first, first + 0x200) if (index, 1) in dictionary]
        return [Pdo(dictionary, index, index + 0x200, receive=receive) for index in present]

    return build(0x1400, receive=True), build(0x1800, receive=False)


def _key(entry: int) -> Key:
    return entry >> 16, entry >> 8 & 0xFF


def _bits(dictionary: Dictionary, key: Key) -> int:
    rule = dictionary.mapping(key)
    return 0 if rule is None else rule[0]
