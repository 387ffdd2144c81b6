"""One CANopen node: NMT, heartbeat, SDO, PDO and EMCY of an `Axis` (CiA 301). Frames are received and sent by
`send`.
"""

from collections.abc import Callable
from enum import IntEnum
from pathlib import Path
from typing import NamedTuple

from simulator.canopen.pdo import process_data
from simulator.canopen.sdo import SdoServer
from simulator.drive.axis import Axis
from simulator.drive.dictionary import Abort, AbortCode, Dictionary
from simulator.drive.host_loss import lose_host


class Frame(NamedTuple):
    """A data frame with an 11-bit identifier."""

    id: int
    data: bytes


SYNC_ID = 0x80


class Nmt(IntEnum):
    """NMT states as in the heartbeat."""

    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


_NMT_COMMANDS = {1: Nmt.OPERATIONAL, 2: Nmt.STOPPED, 128: Nmt.PRE_OPERATIONAL}
_NMT_RESETS = (129, 130)
_CLOCKED_BY_SYNC = 240


class Node:
    """A node with the id `number`."""

    def __init__(
        self,
        number: int,
        eds: Path,
        cycle: float,
        send: Callable[[Frame], None],
        *,
        can_move: bool,
    ) -> None:
        self.number = number
        self.dictionary = Dictionary(eds, number)
        self.axis = Axis(self.dictionary, cycle, can_move=can_move)
        self._server = SdoServer(self.dictionary)
        self._receive, self._transmit = process_data(self.dictionary)
        self._cycle = cycle
        self._raw_send = send
        self.disturbance = self.axis.disturbance
        self.dictionary.on_download((0x1006, 0), self._check_cycle)
        self.dictionary.on_download((0x1016, 1), self._forget_host)
        self.nmt = Nmt.PRE_OPERATIONAL
        self._pending: dict[int, bytes] = {}
        self._late: list[tuple[int, Frame]] = []  # TPDOs to be sent with a later SYNC
        self._syncs = 0
        self._next_heartbeat: float | None = None
        self._host_seen: float | None = None

    def renumber(self, number: int) -> None:
        """Change the id, as by its address switches: the node boots with it. The device itself stays the same."""
        self.number = number
        self.dictionary.renumber(number)
        self.boot()

    def boot(self) -> None:
        """Power-on or reset: torque off, dictionary as in the EDS, boot-up message."""
        self.dictionary.restore()
        self.axis.reset()
        self._server.reset()
        for pdo in (*self._receive, *self._transmit):
            pdo.reset()
        self._pending.clear()
        self._late.clear()
        self.nmt = Nmt.PRE_OPERATIONAL
        self._next_heartbeat = self._host_seen = None
        self._send(Frame(0x700 + self.number, b"\0"))

    def receive(self, frame: Frame, now: float) -> None:
        """Process any frame of the bus except SYNC."""
        if frame.id == 0:
            self._command(frame.data)
        elif frame.id == 0x600 + self.number:
            if self.nmt is not Nmt.STOPPED:
                for response in self._server.handle(frame.data):
                    self._send(Frame(0x580 + self.number, response))
        elif self._host and frame.id == 0x700 + self._host:
            self._host_seen = now
        elif self.nmt is Nmt.OPERATIONAL:
            for k, pdo in enumerate(self._receive):
                if pdo.valid and frame.id == pdo.cob_id:
                    if pdo.transmission_type > _CLOCKED_BY_SYNC:
                        self._apply(k, frame.data)
                    else:
                        self._pending[k] = frame.data
        self._send_emergencies()

    def sync(self, now: float) -> None:
        """Send the present state, then apply the values received before this SYNC."""
        self._syncs += 1
        if not self.disturbance.counter_frozen:
            self.dictionary[0x2120, 1] = (self.dictionary[0x2120, 1] + 1) & 0xFFFFFFFF
        if self.nmt is Nmt.OPERATIONAL:
            self._send_tpdos()
            for k, data in self._pending.items():
                self._apply(k, data)
        self._pending.clear()
        if self.nmt is not Nmt.STOPPED:
            self.axis.sync(now)
        code = self.disturbance.take_fault(counter=self.dictionary[0x2120, 1])
        if code is not None:
            self.axis.fail(code)
        self._send_emergencies()

    def run(self, now: float) -> None:
        """Process everything that is due at `now`, s: heartbeats, time-outs, emergency messages."""
        period = self.dictionary[0x1017, 0] * 1e-3
        if period == 0:
            self._next_heartbeat = None
        elif self._next_heartbeat is None or now >= self._next_heartbeat:
            self._send(Frame(0x700 + self.number, bytes([self.nmt])))
            self._next_heartbeat = max((self._next_heartbeat or now) + period, now)
        timeout = self._host_timeout
        if self._host_seen is not None and 0 < timeout < now - self._host_seen:
            self._host_seen = None
            lose_host(self.axis, self.dictionary)
        self.axis.watch(now)
        self._send_emergencies()

    def due(self, now: float) -> float:
        """Latest time at which `run` must be called, s; infinity if nothing is pending."""
        times = [now if self.dictionary[0x1017, 0] and self._next_heartbeat is None else self._next_heartbeat]
        if self._host_seen is not None and self._host_timeout > 0:
            times.append(self._host_seen + self._host_timeout)
        times.append(self.axis.watch_until)
        return min((time for time in times if time is not None), default=float("inf"))

    @property
    def _host(self) -> int:
        return self.dictionary[0x1016, 1] >> 16 & 0x7F

    @property
    def _host_timeout(self) -> float:
        return (self.dictionary[0x1016, 1] & 0xFFFF) * 1e-3

    def _command(self, data: bytes) -> None:
        if len(data) < 2 or data[1] not in (0, self.number):
            return
        if data[0] in _NMT_RESETS:
            self.boot()
            return
        state = _NMT_COMMANDS.get(data[0], self.nmt)
        if self.nmt is Nmt.OPERATIONAL and state is not Nmt.OPERATIONAL:
            self._pending.clear()
            self.axis.quick_stop()
        self.nmt = state

    def _apply(self, k: int, data: bytes) -> None:
        for (index, subindex), value in self._receive[k].unpack(data):
            try:
                self.dictionary.download(index, subindex, value)
            except Abort:
                continue  # a drive ignores invalid values; monitoring ends the motion if necessary

    def _check_cycle(self, value: int) -> None:
        if value % round(self._cycle * 1e6):
            raise Abort(AbortCode.VALUE)

    def _forget_host(self, _: int) -> None:
        self._host_seen = None

    def _send_tpdos(self) -> None:
        """Send the TPDOs of this SYNC after delayed ones. Each can be ordered to be lost, duplicated or late."""
        order = self.disturbance
        frames = [
            Frame(pdo.cob_id, pdo.pack())
            for pdo in self._transmit
            if pdo.valid and self._syncs % pdo.transmission_type == 0
        ]
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

    def _send_emergencies(self) -> None:
        for message in self.axis.errors.take_messages():
            if self.nmt is not Nmt.STOPPED:
                self._send(Frame(0x80 + self.number, message))

    def _send(self, frame: Frame) -> None:
        if not self.disturbance.mute:
            self._raw_send(frame)
