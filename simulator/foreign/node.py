"""One foreign CANopen node: NMT, heartbeat, SDO, SYNC, PDO and EMCY of an `Axis` (CiA 301). Frames in, frames out."""

from collections.abc import Callable
from pathlib import Path

from simulator.canopen.node import Frame, Nmt
from simulator.canopen.sdo import SdoServer
from simulator.drive.dictionary import Abort
from simulator.foreign.axis import Axis
from simulator.foreign.checks import NUMBER, check_options
from simulator.foreign.dictionary import ForeignDictionary
from simulator.foreign.faults import ErrorCode
from simulator.foreign.heartbeats import Heartbeats
from simulator.foreign.modes import SET_POINTS
from simulator.foreign.pdo import Pdo, process_data
from simulator.foreign.transmission import Transmission
from simulator.foreign.units import Plate, nameplate

_NMT_COMMANDS = {1: Nmt.OPERATIONAL, 2: Nmt.STOPPED, 128: Nmt.PRE_OPERATIONAL}
_NMT_RESETS = (129, 130)
_CONTROLWORD = (0x6040, 0)
_AFTER_ERROR = {0: Nmt.PRE_OPERATIONAL, 2: Nmt.STOPPED}  # 1029h:01; 1: no change


class ForeignNode:
    """A node with the id `number`, with the objects of `file` and the motor of `plate`."""

    def __init__(
        self, number: int, file: Path, plate: Plate, cycle: float, send: Callable[[Frame], None], *, can_move: bool
    ) -> None:
        self.number = number
        self.dictionary = ForeignDictionary(file, number)
        self.axis = Axis(self.dictionary, plate, cycle, can_move=can_move)
        check_options(self.dictionary)
        self.dictionary.nameplate |= nameplate(self.axis.units, self.dictionary)
        self.dictionary.restore()
        self._cycle = cycle
        self._raw_send = send
        self._server = SdoServer(self.dictionary)
        self._receive, transmit = process_data(self.dictionary)
        self.disturbance = self.axis.disturbance
        self._transmission = Transmission(transmit, self.disturbance, self._send)
        self._heartbeats = Heartbeats(self.dictionary)
        self.nmt = Nmt.PRE_OPERATIONAL
        self._pending: dict[int, bytes] = {}
        self._synced: float | None = None  # time of the last SYNC, s
        self._period = 0.0  # s between the last two
        self._syncs = 0  # number of SYNCs since power-on

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
        self._synced, self._syncs = None, 0
        self._enter(Nmt.PRE_OPERATIONAL)
        self._send(Frame(0x700 + self.number, b"\0"))

    @property
    def sync_id(self) -> int:
        """Identifier of SYNC, 1005h."""
        return self.dictionary[0x1005, 0] & NUMBER

    @property
    def led_by_sync(self) -> bool:
        """Whether the set-points of the axis come with SYNC, which is then the clock of the machine."""
        return (
            self.axis.following
            and self.nmt is Nmt.OPERATIONAL
            and self._synced is not None
            and any(p.valid and p.synchronous and not p.entries.isdisjoint(SET_POINTS) for p in self._receive)
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

    def receive(self, frame: Frame, now: float) -> None:
        """Process any frame of the bus except SYNC."""
        if frame.id == 0:
            self._command(frame.data)
        elif frame.id == 0x600 + self.number:
            if self.nmt is not Nmt.STOPPED:
                for response in self._server.handle(frame.data):
                    self._send(Frame(0x580 + self.number, response))
                self.axis.publish()  # units may have changed
        elif 0x700 < frame.id < 0x780:
            self._heartbeats.hear(frame.id - 0x700, now)
        elif self.nmt is Nmt.OPERATIONAL:
            for k, pdo in enumerate(self._receive):
                if pdo.valid and frame.id == pdo.cob_id:
                    self._take(k, pdo, frame.data)
        self._send_emergencies()

    def sync(self, data: bytes, now: float) -> None:
        """Send the present state, then apply the values received before this SYNC."""
        if data:  # none of these drives supports a SYNC counter (1019h)
            self.axis.errors.announce(ErrorCode.SYNC_LENGTH)
        elif self.nmt is Nmt.OPERATIONAL:
            self._period = 0.0 if self._synced is None else now - self._synced
            self._synced = now
            self._transmission.sync()
            self._apply([item for k, data in self._pending.items() for item in self._receive[k].unpack(data)])
            self._pending.clear()
        self._syncs += 1
        code = self.disturbance.take_fault(counter=self._syncs)
        if code is not None:
            self.axis.fail(code)
        self._send_emergencies()

    def run(self, now: float) -> None:
        """Process everything that is due at `now`, s: heartbeats, time-outs, event TPDOs, emergency messages."""
        if self._heartbeats.beat(now):
            self._send(Frame(0x700 + self.number, bytes([self.nmt])))
        if self._heartbeats.missed(now):
            self._lose_host()
        if self.nmt is Nmt.OPERATIONAL:
            self._transmission.run(now)
        self._send_emergencies()

    def due(self, now: float) -> float:
        """Latest time at which `run` must be called, s; infinity if nothing is pending."""
        events = self._transmission.due(now) if self.nmt is Nmt.OPERATIONAL else float("inf")
        return min(self._heartbeats.due(now), events)

    def _lose_host(self) -> None:
        """A heartbeat is missing: an error, the NMT state by 1029h, the motion by 6007h."""
        if self.dictionary[0x6007, 0] != 1 or not self.axis.energised:
            self.axis.errors.announce(ErrorCode.HEARTBEAT)
        if self.axis.energised:
            self.axis.lose_connection()
        if self.nmt is Nmt.OPERATIONAL:
            self._enter(_AFTER_ERROR.get(self.dictionary[0x1029, 1], self.nmt))

    def _command(self, data: bytes) -> None:
        if len(data) < 2 or data[1] not in (0, self.number):
            return
        if data[0] in _NMT_RESETS:
            self.boot()
            return
        state = _NMT_COMMANDS.get(data[0], self.nmt)
        if state is Nmt.STOPPED and self.nmt is not state and self.axis.energised:
            self.axis.lose_connection()  # one of the events of 6007h (CiA 402-2)
        self._enter(state)

    def _enter(self, state: Nmt) -> None:
        if state is not self.nmt:
            self._pending.clear()
            self._transmission.reset()
        self.nmt = state
        free = state is Nmt.PRE_OPERATIONAL or self.dictionary.maker.remaps_operational
        for pdo in (*self._receive, *self._transmission.pdos):
            pdo.configurable = free

    def _take(self, k: int, pdo: Pdo, data: bytes) -> None:
        if len(data) < pdo.size:
            self.axis.errors.announce(ErrorCode.PDO_TOO_SHORT)
            return
        if len(data) > pdo.size:
            self.axis.errors.announce(ErrorCode.PDO_TOO_LONG)
        if pdo.synchronous:
            self._pending[k] = data
        else:
            self._apply(pdo.unpack(data))

    def _apply(self, items: list[tuple[tuple[int, int], bytes]]) -> None:
        """Write the values received together, the controlword last, because it refers to the others."""
        for (index, subindex), value in sorted(items, key=lambda item: item[0] == _CONTROLWORD):
            try:
                self.dictionary.download(index, subindex, value)
            except Abort:
                continue  # a drive ignores invalid values

    def _send_emergencies(self) -> None:
        cob_id = self.dictionary.get(0x1014, 0, 0x80 + self.number)
        for message in self.axis.errors.take_messages():
            if self.nmt is not Nmt.STOPPED and not cob_id >> 31:
                self._send(Frame(cob_id & NUMBER, message))

    def _send(self, frame: Frame) -> None:
        if not self.disturbance.mute:
            self._raw_send(frame)
