"""Process data objects of one node: their configuration, their bytes, and when they are sent (CiA 301, 7.2.2,
7.5.2.36), with ordered disturbances.

The configuration procedure is enforced: COB-ID (except bit 31), inhibit time, mapped objects and their number change
only while the PDO is invalid, and mapped objects only while their number is 0. If the file makes the COB-ID read-only,
only the number must be 0. A PDO has the sub-indices of the file.
"""

from collections.abc import Callable, Sequence
from math import inf
from typing import NamedTuple

from simulator.drive.dictionary import AbortCode, ObjectDictionary, SdoAbort
from simulator.drive.makers import Key
from simulator.drive.power_drive import Disturbance

_INVALID = 1 << 31


class Frame(NamedTuple):
    """A data frame with an 11-bit identifier."""

    id: int
    data: bytes


def check_identifier(cob_id: int) -> None:
    """Raise `SdoAbort` for any flag, an extended identifier, or one reserved by CiA 301, 7.3.5."""
    reserved = ((0x000, 0x07F), (0x101, 0x180), (0x581, 0x5FF), (0x601, 0x67F), (0x6E0, 0x6FF), (0x701, 0x7FF))
    if cob_id & ~0x7FF or any(low <= cob_id <= high for low, high in reserved):
        raise SdoAbort(AbortCode.VALUE)


class PdoChannel:
    """Configured by the objects `communication` (1400h.., 1800h..) and `mapping` (1600h.., 1A00h..)."""

    def __init__(self, dictionary: ObjectDictionary, communication: int, mapping: int, *, receive: bool) -> None:
        self._dictionary = dictionary
        self._communication = communication
        self._mapping = mapping
        self._receive = receive
        self.configurable = True  # whether the present NMT state allows configuration
        self._mapped: tuple[Key, ...] | None = None
        self._types = {*range(1, 241), 254, 255, dictionary[communication, 2]}  # 0 only if the file has it
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
        return self._dictionary[self._communication, 1] & 0x7FF

    @property
    def valid(self) -> bool:
        return not self._dictionary[self._communication, 1] & _INVALID

    @property
    def transmission_type(self) -> int:
        """0: with a SYNC after a change; 1 to 240: every n-th SYNC; 254, 255: immediately."""
        return self._dictionary[self._communication, 2]

    @property
    def synchronous(self) -> bool:
        return self.transmission_type not in (254, 255)

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
        identifier, allowed = value & ~(_INVALID | 1 << 30), self._dictionary.maker.pdo_identifiers  # 30: no request
        if allowed is None:
            check_identifier(identifier)
        elif not value & _INVALID and identifier not in allowed:
            raise SdoAbort(AbortCode.VALUE)
        if self.valid and not value & _INVALID and value & 0x7FF != self.cob_id:
            raise SdoAbort(AbortCode.STATE)

    def _check_type(self, value: int) -> None:
        self._require_configurable()
        if value not in self._types:
            raise SdoAbort(AbortCode.VALUE)

    def _check_count(self, value: int) -> None:
        self._require_changeable()
        d, total = self._dictionary, 0
        for sub in range(1, value + 1):
            if (self._mapping, sub) not in d:
                raise SdoAbort(AbortCode.PDO_LENGTH)
            entry = d[self._mapping, sub]
            d.check_mapping(_key(entry), entry & 0xFF, receive=self._receive)
            total += entry & 0xFF
        if total > 64:
            raise SdoAbort(AbortCode.PDO_LENGTH)
        self._mapped = None

    def _check_entry(self, value: int) -> None:
        self._require_changeable()
        if self._dictionary[self._mapping, 0] != 0:
            raise SdoAbort(AbortCode.STATE)
        if value:
            self._dictionary.check_mapping(_key(value), value & 0xFF, receive=self._receive)

    def _require_changeable(self) -> None:
        self._require_configurable()
        if self.valid and self._switchable:
            raise SdoAbort(AbortCode.STATE)

    def _require_configurable(self) -> None:
        if not self.configurable:
            raise SdoAbort(AbortCode.STATE)


def process_data(dictionary: ObjectDictionary) -> tuple[list[PdoChannel], list[PdoChannel]]:
    """(receive, transmit) PDOs defined by the dictionary."""

    def build(first: int, *, receive: bool) -> list[PdoChannel]:
        present = [index for index in range(first, first + 0x200) if (index, 1) in dictionary]
        return [PdoChannel(dictionary, index, index + 0x200, receive=receive) for index in present]

    return build(0x1400, receive=True), build(0x1800, receive=False)


def _key(entry: int) -> Key:
    return entry >> 16, entry >> 8 & 0xFF


class Transmission:
    """All TPDOs of one node."""

    def __init__(self, pdos: Sequence[PdoChannel], order: Disturbance, send: Callable[[Frame], None]) -> None:
        self.pdos = tuple(pdos)
        self._order = order
        self._send = send
        self.reset()

    def reset(self) -> None:
        """Nothing was sent yet, as when the node becomes operational."""
        self._syncs = 0
        self._sent: dict[int, tuple[bytes, float]] = {}
        self._late: list[tuple[int, Frame]] = []  # to be sent with a later SYNC

    def sync(self) -> None:
        """Send the TPDOs of this SYNC after delayed ones. Each can be ordered to be lost, duplicated or late."""
        self._syncs += 1
        order = self._order
        frames = [Frame(pdo.cob_id, pdo.pack()) for k, pdo in enumerate(self.pdos) if self._of_this_sync(k, pdo)]
        late = [frame for due, frame in self._late if due <= self._syncs]
        self._late = [(due, frame) for due, frame in self._late if due > self._syncs]
        if frames and order.delay_tpdos > 0:
            order.delay_tpdos -= 1
            self._late += [(self._syncs + order.delay_cycles, frame) for frame in frames]
            frames = []
        if frames and order.duplicate_tpdos > 0:
            order.duplicate_tpdos -= 1
            frames *= 2
        for frame in late + frames:
            if order.drop_tpdos > 0:
                order.drop_tpdos -= 1
            else:
                self._send(frame)

    def run(self, now: float) -> None:
        """Send event TPDOs: a value changed, or the event timer expired; never within the inhibit time."""
        for k, pdo in enumerate(self.pdos):
            if pdo.synchronous or not pdo.valid or not pdo.keys:
                continue
            data, (before, when) = pdo.pack(), self._sent.get(k, (None, -inf))
            timed = 0 < pdo.event_time <= now - when
            if (data != before or timed) and now - when >= pdo.inhibit_time:
                self._sent[k] = data, now
                self._send(Frame(pdo.cob_id, data))

    def due(self, now: float) -> float:
        """Latest time at which `run` must be called, s; infinity if nothing is pending."""
        times: list[float] = []
        for k, pdo in enumerate(self.pdos):
            if pdo.synchronous or not pdo.valid or not pdo.keys:
                continue
            before, when = self._sent.get(k, (None, -inf))
            if pdo.event_time:
                times.append(max(when + pdo.event_time, now))
            if pdo.pack() != before:
                times.append(max(when + pdo.inhibit_time, now))
        return min(times, default=inf)

    def _of_this_sync(self, k: int, pdo: PdoChannel) -> bool:
        if not pdo.valid or not pdo.synchronous or not pdo.keys:
            return False
        if pdo.transmission_type:
            return self._syncs % pdo.transmission_type == 0
        data, (before, _) = pdo.pack(), self._sent.get(k, (None, -inf))
        self._sent[k] = data, -inf
        return data != before
