"""The stop of Modbus TCP drives from a process of its own: a connection made for it, for a drive may take one alone."""

import select
import socket
import struct
import time
from collections.abc import Mapping

from drivers.cia402 import states
from drivers.errors import ConnectionFailed, NotReady
from drivers.modbus.line import WRITE
from drivers.modbus.profile import ModbusProfile, TcpLine
from drivers.modbus.registers import RegisterMap

CONNECT_TIMEOUT = 0.5  # s
ANSWER_TIMEOUT = 0.03  # s for a unit, before the next is told
_HEAD = struct.Struct(">HHHB")  # transaction, protocol 0, length of the rest, unit: Modbus messaging on TCP/IP V1.0b


class ModbusStopSender:
    """See `drivers.ports.StopSender`. The transaction's number is the unit's, and so it is in its answer."""

    def __init__(self, profile: ModbusProfile, registers: RegisterMap) -> None:
        """NotReady on a serial line."""
        if not isinstance(profile.line, TcpLine):
            raise NotReady(f"Modbus {profile.line.place}: a serial line has one owner, which is the service")
        self._line = profile.line
        signal = registers.signals["controlword"]
        words = signal.format.encode(states.QUICK_STOP, round)
        body = struct.pack(f">BHHB{len(words)}H", WRITE, signal.address, len(words), 2 * len(words), *words)
        self._joints = {axis.unit_id: axis.joint for axis in profile.axes}
        self._requests = {unit: _HEAD.pack(unit, 0, len(body) + 1, unit) + body for unit in self._joints}

    def open(self) -> None:
        """Nothing is held open."""

    def listen(self, within: float) -> None:
        time.sleep(within)

    def send(self) -> Mapping[str, str]:
        """One unit after the other, for many a server drops a request that comes before it has answered the last."""
        try:
            with socket.create_connection((self._line.host, self._line.port), CONNECT_TIMEOUT) as line:
                line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                answered = set[int]()
                for unit, request in self._requests.items():
                    line.sendall(request)
                    answered |= _answers(line, unit)
        except OSError as error:
            raise ConnectionFailed(f"Modbus {self._line.place}: {error}") from None
        return {joint: "" if unit in answered else "did not answer" for unit, joint in self._joints.items()}

    def insist(self) -> None:
        self.send()

    def close(self) -> None:
        """Nothing is held open."""


def _answers(line: socket.socket, unit: int) -> set[int]:
    """The units that took the word, of those that answer until `unit` has or its time is over."""
    taken, deadline, data = set[int](), time.monotonic() + ANSWER_TIMEOUT, b""
    while (left := deadline - time.monotonic()) > 0 and select.select([line], [], [], left)[0]:
        more = line.recv(4096)
        if not more:
            raise OSError("closed by the drives")
        data += more
        while len(data) > _HEAD.size and len(data) >= 6 + (head := _HEAD.unpack_from(data))[2]:
            if data[_HEAD.size] == WRITE:
                taken.add(head[0])
            if head[0] == unit:
                return taken
            data = data[6 + head[2] :]
    return taken
