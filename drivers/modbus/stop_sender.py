"""The stop of Modbus TCP drives from another process, connected only for it: a drive may accept one client only."""

import itertools
import select
import socket
import struct
import time
from collections.abc import Collection, Mapping

from drivers.cia402 import states
from drivers.cia402.states import Controlword
from drivers.errors import ConnectionFailed, NotReady
from drivers.modbus.line import READ, WRITE
from drivers.modbus.profile import DIRECT, ModbusAxis, ModbusProfile, TcpProfile
from drivers.modbus.registers import RegisterMap

LATE_ANSWER = 0.1  # s for a unit that did not answer in time; the stop is sent again after all others
_SILENT = "did not answer"
_HEAD = struct.Struct(">HHHB")  # transaction, protocol 0, length of the rest, unit: Modbus messaging on TCP/IP V1.0b


class ModbusStopSender:
    """See `drivers.ports.StopSender`. The transaction id is the unit id, so that an answer identifies its unit."""

    connect_timeout = 0.3  # s
    sending = 0.5  # s in which the stop is sent again, so that some of the answer's 1.2 s are left to confirm

    def __init__(self, profile: ModbusProfile, registers: RegisterMap) -> None:
        """Raises NotReady on a serial line."""
        if not isinstance(profile.line, TcpProfile):
            raise NotReady(
                f"Modbus {profile.line.place}: only one process can open a serial line, and the service has it"
            )
        self._line = profile.line
        self._axes, self._map = profile.axes, registers
        signal = registers.signals["controlword"]
        words = signal.format.encode(Controlword.QUICK_STOP, round)
        body = struct.pack(f">BHHB{len(words)}H", WRITE, signal.address, len(words), 2 * len(words), *words)
        self._joints = {axis.unit_id: axis.joint for axis in profile.axes}
        self._requests = {unit: _HEAD.pack(unit, 0, len(body) + 1, unit) + body for unit in self._joints}

    def open(self) -> None:
        """Nothing is held open."""

    def listen(self, within: float) -> None:
        time.sleep(within)

    def send(self) -> Mapping[str, str]:
        """One unit after the other, because many servers drop a request that arrives before the last one is answered.

        If a unit was slow, the next one may not have received the stop: it is sent again to all units that have not
        answered.
        """
        try:
            with socket.create_connection((self._line.host, self._line.port), self.connect_timeout) as line:
                line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                answers = _Answers(line)
                until = time.monotonic() + self.sending
                for unit, request in self._requests.items():
                    line.sendall(request)
                    answers.wait_for([unit], 0.03)  # s before the next is told
                answers.wait_for(self._requests, LATE_ANSWER)
                missing = itertools.cycle(self._requests)
                while not answers.complete(self._requests) and time.monotonic() < until:
                    unit = next(unit for unit in missing if unit not in answers.words)
                    line.sendall(self._requests[unit])
                    answers.wait_for([unit], LATE_ANSWER)
        except OSError as error:
            raise ConnectionFailed(f"Modbus {self._line.place}: {error}") from None
        return {joint: answers.words.get(unit, _SILENT) for unit, joint in self._joints.items()}

    def confirm(self, within: float) -> Mapping[str, str]:
        """Asks one unit after the other for statusword and velocity; those that did not answer last time come last."""
        if within <= 0:
            return dict.fromkeys(self._joints.values(), "no time was left to ask it")
        deadline = time.monotonic() + within
        doubts = dict.fromkeys(self._joints.values(), _SILENT)
        try:
            with socket.create_connection(
                (self._line.host, self._line.port), min(self.connect_timeout, within)
            ) as line:
                line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                readings = _Readings(line, self._map, deadline)
                while any(doubts.values()) and time.monotonic() < deadline:
                    open_ones = [axis for axis in self._axes if doubts[axis.joint]]
                    for axis in sorted(open_ones, key=lambda axis: doubts[axis.joint] == _SILENT):
                        found = _doubt(readings, axis)
                        if found != _SILENT or time.monotonic() < deadline:  # else there was no time to answer
                            doubts[axis.joint] = found
                    time.sleep(max(0.0, min(0.01, deadline - time.monotonic())))
        except OSError as error:
            why = f"Modbus {self._line.place}: {error}"
            return {joint: doubt and why for joint, doubt in doubts.items()}
        return doubts

    def insist(self) -> None:
        self.send()

    def close(self) -> None:
        """Nothing is held open."""


def _doubt(readings: "_Readings", axis: ModbusAxis) -> str:
    """Why the axis does not report standstill without energy; "" if it does."""
    word = readings.value(axis.unit_id, "statusword")
    if word is None:
        return _SILENT
    state = states.decode(int(word))
    if state in states.ENERGISED or state is states.PowerState.UNKNOWN:
        return f"reports '{state.value}'"
    speed = readings.value(axis.unit_id, "velocity")
    if speed is None:
        return _SILENT
    velocity = axis.gear.motor_velocity(speed)
    return "" if abs(velocity) <= axis.standstill_velocity else f"reports {velocity:.3g} {axis.unit}/s"


class _Readings:
    """Signals of units, read one after the other on a line until `deadline`; each request has its own transaction."""

    def __init__(self, line: socket.socket, registers: RegisterMap, deadline: float) -> None:
        self._line, self._map, self._deadline = line, registers, deadline
        self._numbers = itertools.cycle(range(1, 0x10000))
        self._data = b""

    def value(self, unit: int, name: str) -> float | None:
        """None if the unit does not answer in time, or refuses. Raises OSError if the drives close the line."""
        signal, number = self._map.signals[name], next(self._numbers)
        body = struct.pack(">BHH", READ, signal.address, signal.format.width)
        self._line.sendall(_HEAD.pack(number, 0, len(body) + 1, unit) + body)
        until = min(time.monotonic() + LATE_ANSWER, self._deadline)
        while (left := until - time.monotonic()) > 0 and select.select([self._line], [], [], left)[0]:
            more = self._line.recv(4096)
            if not more:
                raise OSError("closed by the drives")
            pdu = self._taken(self._data + more, number, unit)
            if pdu is not None:
                words = [int.from_bytes(pdu[k : k + 2], "big") for k in range(2, len(pdu), 2)]
                fits = pdu[0] == READ and len(words) == signal.format.width
                return float(signal.format.decode(words)[0]) if fits else None
        return None

    def _taken(self, data: bytes, number: int, unit: int) -> bytes | None:
        """The PDU that answers a transaction; late answers to others are dropped."""
        found = None
        while len(data) > _HEAD.size and len(data) >= (whole := 6 + _HEAD.unpack_from(data)[2]):
            transaction, _, _, sender = _HEAD.unpack_from(data)
            if transaction == number and sender in (unit, *DIRECT):
                found = data[_HEAD.size : whole]
            data = data[whole:]
        self._data = data
        return found


class _Answers:
    """Answers received on a line so far: `words` by unit, empty if the unit accepted the stop."""

    def __init__(self, line: socket.socket) -> None:
        self.words: dict[int, str] = {}
        self._line = line
        self._data = b""

    def complete(self, units: Collection[int]) -> bool:
        return self.words.keys() >= set(units)

    def wait_for(self, units: Collection[int], seconds: float) -> None:
        """Read until all of these units have answered or the time is over. OSError if the drives close the line."""
        deadline = time.monotonic() + seconds
        while not self.complete(units):
            left = deadline - time.monotonic()
            if left <= 0 or not select.select([self._line], [], [], left)[0]:
                return
            more = self._line.recv(4096)
            if not more:
                raise OSError("closed by the drives")
            self._read(self._data + more)

    def _read(self, data: bytes) -> None:
        while len(data) > _HEAD.size and len(data) >= (whole := 6 + _HEAD.unpack_from(data)[2]):
            unit, function = _HEAD.unpack_from(data)[0], data[_HEAD.size]
            self.words[unit] = "" if function == WRITE else "refused the stop"
            data = data[whole:]
        self._data = data
