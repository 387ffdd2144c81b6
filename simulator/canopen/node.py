"""One CANopen node: NMT, heartbeats, SDO, SYNC, PDO and EMCY of an axis (CiA 301). Frames and times in, frames out.

SDO server: request bytes in, response bytes out (CiA 301, 7.2.4.3). Expedited, segmented, block upload.
"""

import binascii
import struct
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from math import inf
from pathlib import Path
from typing import Generic, TypeVar

from simulator.canopen.pdo import Frame, PdoChannel, Transmission, check_identifier, process_data
from simulator.drive.dictionary import AbortCode, ObjectDictionary, SdoAbort
from simulator.drive.foreign_axis import ForeignAxis, MotorPlate, nameplate
from simulator.drive.power_drive import FaultCode, PowerDrive
from simulator.drive.virtual_axis import VirtualAxis


@dataclass(slots=True)
class _Transfer:
    """A transfer that needs more than one request."""

    index: int
    subindex: int
    data: bytearray
    download: bool
    toggle: int = 0
    offset: int = 0  # block upload: acknowledged bytes
    block_size: int = 0  # block upload: segments per block
    ended: bool = False  # block upload: everything is sent and acknowledged


class SdoServer:
    """One server channel. `handle` does not raise for any request of a client."""

    head = struct.Struct("<BHB")

    def __init__(self, dictionary: ObjectDictionary) -> None:
        self._dictionary = dictionary
        self._transfer: _Transfer | None = None
        self._multiplexer = (0, 0)

    def reset(self) -> None:
        """Discard a transfer in progress."""
        self._transfer = None

    def handle(self, request: bytes) -> list[bytes]:
        """Answer one request of 8 bytes with none, one or (block upload) many responses."""
        if len(request) != 8:
            return []
        try:
            return self._dispatch(request)
        except SdoAbort as abort:
            self._transfer = None
            return [struct.pack("<BHBI", 0x80, *self._multiplexer, abort.code)]

    def _dispatch(self, request: bytes) -> list[bytes]:
        command = request[0]
        match command >> 5:
            case 1:
                return [self._initiate_download(request)]
            case 0:
                return [self._download_segment(request)]
            case 2:
                return [self._initiate_upload(request)]
            case 3:
                return [self._upload_segment(command)]
            case 4:
                self._transfer = None
                return []
            case 5:
                return self._block_upload(request)
            case _:
                raise SdoAbort(AbortCode.COMMAND)

    def _initiate(self, request: bytes) -> tuple[int, int]:
        _, index, subindex = SdoServer.head.unpack_from(request)
        self._transfer = None
        self._multiplexer = (index, subindex)
        return index, subindex

    def _initiate_download(self, request: bytes) -> bytes:
        index, subindex = self._initiate(request)
        command = request[0]
        if command & 0x02:
            size = 4 - ((command >> 2) & 3) if command & 0x01 else 4
            self._dictionary.download(index, subindex, request[4 : 4 + size])
        else:
            self._transfer = _Transfer(index, subindex, bytearray(), download=True)
        return SdoServer.head.pack(0x60, index, subindex) + bytes(4)

    def _download_segment(self, request: bytes) -> bytes:
        transfer = self._toggled(request[0], download=True)
        transfer.data += request[1 : 8 - ((request[0] >> 1) & 7)]
        if len(transfer.data) > 4096:
            raise SdoAbort(AbortCode.TOO_LONG)
        if request[0] & 0x01:
            self._transfer = None
            self._dictionary.download(transfer.index, transfer.subindex, bytes(transfer.data))
        return bytes([0x20 | transfer.toggle ^ 0x10]) + bytes(7)

    def _initiate_upload(self, request: bytes) -> bytes:
        index, subindex = self._initiate(request)
        data = self._dictionary.upload(index, subindex)
        if not data:
            raise SdoAbort(AbortCode.NO_DATA)
        if len(data) <= 4:
            return SdoServer.head.pack(0x43 | (4 - len(data)) << 2, index, subindex) + data.ljust(4, b"\0")
        self._transfer = _Transfer(index, subindex, bytearray(data), download=False)
        return struct.pack("<BHBI", 0x41, index, subindex, len(data))

    def _upload_segment(self, command: int) -> bytes:
        transfer = self._toggled(command, download=False)
        segment = bytes(transfer.data[:7])
        del transfer.data[:7]
        head = transfer.toggle ^ 0x10 | (7 - len(segment)) << 1
        if not transfer.data:
            head |= 1
            self._transfer = None
        return bytes([head]) + segment.ljust(7, b"\0")

    def _toggled(self, command: int, *, download: bool) -> _Transfer:
        transfer = self._transfer
        if transfer is None or transfer.block_size or transfer.download is not download:
            raise SdoAbort(AbortCode.COMMAND)
        if command & 0x10 != transfer.toggle:
            raise SdoAbort(AbortCode.TOGGLE)
        transfer.toggle ^= 0x10
        return transfer

    def _block_upload(self, request: bytes) -> list[bytes]:
        subcommand = request[0] & 0x03
        if subcommand == 0:
            index, subindex = self._initiate(request)
            if not self._dictionary.block_upload:
                raise SdoAbort(AbortCode.COMMAND)
            data = self._dictionary.upload(index, subindex)
            if not data:
                raise SdoAbort(AbortCode.NO_DATA)
            size = _block_size(request[4])
            self._transfer = _Transfer(index, subindex, bytearray(data), download=False, block_size=size)
            return [struct.pack("<BHBI", 0xC6, index, subindex, len(data))]
        transfer = self._transfer
        if transfer is None or not transfer.block_size:
            raise SdoAbort(AbortCode.COMMAND)
        if subcommand == 3:
            return self._block(transfer)
        if subcommand == 2:
            transfer.offset = min(transfer.offset + 7 * min(request[1], transfer.block_size), len(transfer.data))
            transfer.block_size = _block_size(request[2])
            if transfer.offset < len(transfer.data):
                return self._block(transfer)
            transfer.ended = True
            unused = -len(transfer.data) % 7
            return [struct.pack("<BH", 0xC1 | unused << 2, binascii.crc_hqx(transfer.data, 0)) + bytes(5)]
        self._transfer = None  # end of the transfer, acknowledged by the client
        if not transfer.ended:
            raise SdoAbort(AbortCode.COMMAND)
        return []

    @staticmethod
    def _block(transfer: _Transfer) -> list[bytes]:
        data, start = transfer.data, transfer.offset
        frames: list[bytes] = []
        for number in range(1, transfer.block_size + 1):
            segment = data[start : start + 7]
            start += 7
            last = start >= len(data)
            frames.append(bytes([number | (0x80 if last else 0)]) + bytes(segment).ljust(7, b"\0"))
            if last:
                break
        return frames


def _block_size(wanted: int) -> int:
    if not 1 <= wanted <= 127:
        raise SdoAbort(AbortCode.BLOCK_SIZE)
    return wanted


class Nmt(IntEnum):
    """NMT states as in the heartbeat."""

    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


class Heartbeats:
    """Producer and consumers of one node. Other nodes are monitored from their first heartbeat on."""

    def __init__(self, dictionary: ObjectDictionary) -> None:
        self._dictionary = dictionary
        self._subs = [sub for _, sub in dictionary.keys(0x1016) if sub]
        for sub in self._subs:
            dictionary.on_download((0x1016, sub), lambda value, sub=sub: self._watch(value, sub))
        self.reset()

    def reset(self) -> None:
        """As at power-on."""
        self._next: float | None = None
        self._heard: dict[int, float] = {}

    def hear(self, number: int, now: float) -> None:
        """A heartbeat or boot-up message of node `number`."""
        if any(node == number for node, _ in self._watched()):
            self._heard[number] = now

    def beat(self, now: float) -> bool:
        """Whether the heartbeat of the node is due; it then counts as sent."""
        period = self._dictionary.get(0x1017) * 1e-3
        if period == 0:
            self._next = None
            return False
        if self._next is not None and now < self._next:
            return False
        self._next = max((self._next or now) + period, now)
        return True

    def missed(self, now: float) -> bool:
        """Whether a heartbeat is missing now; reported once, until it is received again."""
        late = [n for n, time in self._watched() if n in self._heard and now - self._heard[n] > time]
        for number in late:
            del self._heard[number]
        return bool(late)

    def due(self, now: float) -> float:
        """Time of the next call, s; infinity if never."""
        times = [self._heard[number] + time for number, time in self._watched() if number in self._heard]
        if self._dictionary.get(0x1017):
            times.append(now if self._next is None else self._next)
        return min(times, default=inf)

    def _watched(self) -> list[tuple[int, float]]:
        """(node, time in s) of every consumer in use."""
        values = [self._dictionary[0x1016, sub] for sub in self._subs]
        return [(v >> 16 & 0x7F, (v & 0xFFFF) * 1e-3) for v in values if v >> 16 & 0x7F and v & 0xFFFF]

    def _watch(self, value: int, sub: int) -> None:
        number = value >> 16 & 0xFF
        others = [self._dictionary[0x1016, other] for other in self._subs if other != sub]
        if number and value & 0xFFFF and any(o & 0xFFFF and o >> 16 & 0x7F == number for o in others):
            raise SdoAbort(AbortCode.INCOMPATIBLE)
        self._heard.pop(number, None)


AnyAxis = TypeVar("AnyAxis", bound=PowerDrive)


class CanopenNode(Generic[AnyAxis]):
    """The node `number` of `axis`."""

    def __init__(
        self, number: int, dictionary: ObjectDictionary, axis: AnyAxis, cycle: float, send: Callable[[Frame], None]
    ) -> None:
        self.number = number
        self.dictionary = dictionary
        self.axis = axis
        self.disturbance = axis.disturbance
        self.nmt = Nmt.PRE_OPERATIONAL
        self._cycle = cycle
        self._raw_send = send
        self._server = SdoServer(dictionary)
        self._receive, transmit = process_data(dictionary)
        self._transmission = Transmission(transmit, self.disturbance, self._send)
        self._heartbeats = Heartbeats(dictionary)
        self._pending: dict[int, bytes] = {}  # data of RPDOs that wait for SYNC

    def renumber(self, number: int) -> None:
        """Change the id, as by its address switches: the node boots with it. The device itself stays the same."""
        self.number = number
        self.dictionary.renumber(number)
        self.boot()

    def boot(self) -> None:
        """Power-on or reset: torque off, dictionary as at power-on, boot-up message."""
        self.dictionary.restore()
        self.axis.reset()
        self._server.reset()
        for pdo in (*self._receive, *self._transmission.pdos):
            pdo.reset()
        self._transmission.reset()
        self._heartbeats.reset()
        self._pending.clear()
        self._enter(Nmt.PRE_OPERATIONAL)
        self._send(Frame(0x700 + self.number, b"\0"))

    def receive(self, frame: Frame, now: float) -> None:
        """Process any frame of the bus except SYNC."""
        if frame.id == 0:
            self._command(frame.data)
        elif frame.id == 0x600 + self.number:
            if self.nmt is not Nmt.STOPPED:
                for response in self._server.handle(frame.data):
                    self._send(Frame(0x580 + self.number, response))
                self._served()
        elif 0x700 < frame.id < 0x780:
            self._heartbeats.hear(frame.id - 0x700, now)
        elif self.nmt is Nmt.OPERATIONAL:
            for k, pdo in enumerate(self._receive):
                if pdo.valid and frame.id == pdo.cob_id and self._fits(pdo, frame.data):
                    if pdo.synchronous:
                        self._pending[k] = frame.data
                    else:
                        self._apply(pdo.unpack(frame.data))
        self._send_emergencies()

    def run(self, now: float) -> None:
        """Process everything that is due at `now`, s: heartbeats, time-outs, PDOs, emergency messages."""
        if self._heartbeats.beat(now):
            self._send(Frame(0x700 + self.number, bytes([self.nmt])))
        if self._heartbeats.missed(now):
            self._lose_host()
        self._run(now)
        self._send_emergencies()

    def due(self, now: float) -> float:
        """Latest time at which `run` must be called, s; infinity if nothing is pending."""
        return self._heartbeats.due(now)

    def _command(self, data: bytes) -> None:
        if len(data) < 2 or data[1] not in (0, self.number):
            return
        if data[0] in (129, 130):
            self.boot()
            return
        states = {1: Nmt.OPERATIONAL, 2: Nmt.STOPPED, 128: Nmt.PRE_OPERATIONAL}
        state = states.get(data[0], self.nmt)
        if state is not self.nmt:
            self._leave(state)
        self._enter(state)

    def _enter(self, state: Nmt) -> None:
        if state is not self.nmt:
            self._pending.clear()
            self._transmission.reset()
        self.nmt = state
        free = state is Nmt.PRE_OPERATIONAL or self.dictionary.maker.remaps_operational
        for pdo in (*self._receive, *self._transmission.pdos):
            pdo.configurable = free

    def _take_pending(self) -> list[tuple[tuple[int, int], bytes]]:
        items = [item for k, data in self._pending.items() for item in self._receive[k].unpack(data)]
        self._pending.clear()
        return items

    def _apply(self, items: list[tuple[tuple[int, int], bytes]]) -> None:
        for (index, subindex), value in items:
            try:
                self.dictionary.download(index, subindex, value)
            except SdoAbort:
                continue  # a drive ignores invalid values; monitoring ends the motion if necessary

    def _send_emergencies(self) -> None:
        messages = self.axis.errors.take_messages()
        cob_id = self.dictionary.get(0x1014, 0, 0x80 + self.number) if messages else 0
        for message in messages:
            if self.nmt is not Nmt.STOPPED and not cob_id >> 31:
                self._send(Frame(cob_id & 0x7FF, message))

    def _send(self, frame: Frame) -> None:
        if not self.disturbance.mute:
            self._raw_send(frame)

    # What a maker's node does otherwise

    def _fits(self, pdo: PdoChannel, data: bytes) -> bool:
        """Whether an RPDO of this length is taken."""
        return len(data) >= pdo.size

    def _served(self) -> None:
        """An SDO request was answered."""

    def _leave(self, state: Nmt) -> None:
        """A command leads from the present NMT state to another one."""

    def _lose_host(self) -> None:
        self.axis.lose_host()

    def _run(self, now: float) -> None:
        """Timers of this node alone."""


class VirtualNode(CanopenNode[VirtualAxis]):
    """A node of the virtual drive."""

    def __init__(self, number: int, eds: Path, cycle: float, send: Callable[[Frame], None], *, can_move: bool) -> None:
        dictionary = ObjectDictionary(eds, number)
        super().__init__(number, dictionary, VirtualAxis(dictionary, cycle, can_move=can_move), cycle, send)
        dictionary.on_download((0x1006, 0), self._check_cycle)

    def sync(self, now: float) -> None:
        """Send the present state, then apply the values received before this SYNC."""
        d = self.dictionary
        if not self.disturbance.counter_frozen:
            d[0x2120, 1] = (d[0x2120, 1] + 1) & 0xFFFFFFFF
        if self.nmt is Nmt.OPERATIONAL:
            self._transmission.sync()
            self._apply(self._take_pending())
        if self.nmt is not Nmt.STOPPED:
            self.axis.sync(now)
        code = self.disturbance.take_fault(counter=d[0x2120, 1])
        if code is not None:
            self.axis.fail(code)
        self._send_emergencies()

    def due(self, now: float) -> float:
        watched = self.axis.watch_until
        return min(super().due(now), inf if watched is None else watched)

    def _run(self, now: float) -> None:
        self.axis.watch(now)

    def _leave(self, state: Nmt) -> None:
        if self.nmt is Nmt.OPERATIONAL:
            self.axis.quick_stop()

    def _check_cycle(self, value: int) -> None:
        if value % round(self._cycle * 1e6):
            raise SdoAbort(AbortCode.VALUE)


class ForeignNode(CanopenNode[ForeignAxis]):
    """A node with the objects of `file` and the motor of `plate`."""

    def __init__(
        self, number: int, file: Path, plate: MotorPlate, cycle: float, send: Callable[[Frame], None], *, can_move: bool
    ) -> None:
        d = ObjectDictionary(file, number, None)
        axis = ForeignAxis(d, plate, cycle, can_move=can_move)
        self._check_options(d)
        d.nameplate |= nameplate(axis.units, d)
        d.restore()
        self._synced: float | None = None  # time of the last SYNC, s
        self._period = 0.0  # s between the last two
        self._syncs = 0  # number of SYNCs since power-on
        super().__init__(number, d, axis, cycle, send)

    def boot(self) -> None:
        self._synced, self._syncs = None, 0
        super().boot()

    @property
    def sync_id(self) -> int:
        """Identifier of SYNC, 1005h."""
        return self.dictionary[0x1005, 0] & 0x7FF

    @property
    def led_by_sync(self) -> bool:
        """Whether the set-points of the axis come with SYNC, which is then the clock of the machine."""
        set_points = {(0x607A, 0), (0x60B0, 0), (0x60B1, 0), (0x60B2, 0), (0x60C1, 1), (0x60FF, 0)}
        return (
            self.axis.following
            and self.nmt is Nmt.OPERATIONAL
            and self._synced is not None
            and any(p.valid and p.synchronous and not set_points.isdisjoint(p.keys) for p in self._receive)
        )

    @property
    def synced_at(self) -> float:
        """Time of the last SYNC, s of the clock of `sync`; 0 if there was none."""
        return self._synced or 0.0

    @property
    def sync_cycles(self) -> int:
        """Length of a SYNC period in cycles of the machine: from 1006h, else 60C2h, else measured."""
        d = self.dictionary
        period = d.get(0x1006) * 1e-6 or d.get(0x60C2, 1) * 10.0 ** d.get(0x60C2, 2, -3) or self._period
        return max(round(period / self._cycle), 1)

    def sync(self, data: bytes, now: float) -> None:
        """Send the present state, then apply the values received before this SYNC."""
        if data:  # none of these drives supports a SYNC counter (1019h)
            self.axis.errors.announce(FaultCode.SYNC_LENGTH)
        elif self.nmt is Nmt.OPERATIONAL:
            self._period = 0.0 if self._synced is None else now - self._synced
            self._synced = now
            self._transmission.sync()
            self._apply(self._take_pending())
        self._syncs += 1
        code = self.disturbance.take_fault(counter=self._syncs)
        if code is not None:
            self.axis.fail(code)
        self._send_emergencies()

    def due(self, now: float) -> float:
        return min(super().due(now), self._transmission.due(now) if self.nmt is Nmt.OPERATIONAL else inf)

    def _run(self, now: float) -> None:
        if self.nmt is Nmt.OPERATIONAL:
            self._transmission.run(now)

    def _served(self) -> None:
        self.axis.publish()  # units may have changed

    def _fits(self, pdo: PdoChannel, data: bytes) -> bool:
        if len(data) != pdo.size:
            short = len(data) < pdo.size
            self.axis.errors.announce(FaultCode.PDO_TOO_SHORT if short else FaultCode.PDO_TOO_LONG)
        return super()._fits(pdo, data)

    def _apply(self, items: list[tuple[tuple[int, int], bytes]]) -> None:
        """The controlword last, because it refers to the other values received together."""
        super()._apply(sorted(items, key=lambda item: item[0] == (0x6040, 0)))

    def _leave(self, state: Nmt) -> None:
        if state is Nmt.STOPPED and self.axis.energised:
            self.axis.lose_host()  # one of the events of 6007h (CiA 402-2)

    def _lose_host(self) -> None:
        """A heartbeat is missing: an error, the NMT state by 1029h, the motion by 6007h."""
        if self.dictionary[0x6007, 0] != 1 or not self.axis.energised:
            self.axis.errors.announce(FaultCode.HEARTBEAT)
        self.axis.lose_host()
        if self.nmt is Nmt.OPERATIONAL:
            after = {0: Nmt.PRE_OPERATIONAL, 2: Nmt.STOPPED}  # 1: no change
            self._enter(after.get(self.dictionary[0x1029, 1], self.nmt))

    @staticmethod
    def _check_options(dictionary: ObjectDictionary) -> None:
        """Refuse option codes that no drive supports, and identifiers of SYNC and EMCY that are reserved."""
        known = {0x605A: (0, 1, 2, 3, 5, 6, 7), 0x605B: (0, 1), 0x605C: (0, 1), 0x605D: (1, 2), 0x605E: (0, 1, 2, 3)}

        def check(value: int, options: tuple[int, ...]) -> None:
            if value not in options:
                raise SdoAbort(AbortCode.VALUE)

        for index, options in known.items():
            dictionary.on_download((index, 0), lambda value, options=options: check(value, options))
        dictionary.on_download((0x1005, 0), check_identifier)
        dictionary.on_download((0x1014, 0), lambda value: check_identifier(value & ~(1 << 31)))
