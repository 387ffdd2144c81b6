"""The stop of Modbus TCP drives from a separate process. It connects only for the stop: a drive may accept one client
only.
"""

import select
import socket
import struct
import time
from collections.abc import Collection, Mapping

from drivers.cia402 import states
from drivers.errors import ConnectionFailed, NotReady
from drivers.modbus.line import WRITE
from drivers.modbus.profile import ModbusProfile, TcpLine
from drivers.modbus.registers import RegisterMap

CONNECT_TIMEOUT = 0.5  # s
ANSWER_TIMEOUT = 0.03  # s for a unit, before the stop is sent to the next
LATE_ANSWER = 0.1  # s for a unit that did not answer then; the stop is sent again after all others
INSISTENCE = 0.5  # s in total for such units
_HEAD = struct.Struct(">HHHB")  # transaction, protocol 0, length of the rest, unit: Modbus messaging on TCP/IP V1.0b


class ModbusStopSender:
    """See `drivers.ports.StopSender`. The transaction id is the unit id, so that an answer identifies its unit."""

    def __init__(self, profile: ModbusProfile, registers: RegisterMap) -> None:
        """Raises NotReady on a serial line."""
        if not isinstance(profile.line, TcpLine):
            raise NotReady(
                f"Modbus {profile.line.place}: only one process can open a serial line, and the service has it"
            )
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
        """One unit after the other, because many servers drop a request that arrives before the last one is answered.

        If a unit was slow, the next one may not have received the stop: it is sent again to all units that have not
        answered.
        """
        try:
            with socket.create_connection((self._line.host, self._line.port), CONNECT_TIMEOUT) as line:
                line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                answers = _Answers(line)
                for unit, request in self._requests.items():
                    line.sendall(request)
                    answers.wait_for([unit], ANSWER_TIMEOUT)
                answers.wait_for(self._requests, LATE_ANSWER)
                until = time.monotonic() + INSISTENCE
                while time.monotonic() < until and (missing := self._requests.keys() - answers.words.keys()):
                    for unit in missing:
                        line.sendall(self._requests[unit])
                        answers.wait_for([unit], LATE_ANSWER)
        except OSError as error:
            raise ConnectionFailed(f"Modbus {self._line.place}: {error}") from None
        return {joint: answers.words.get(unit, "did not answer") for unit, joint in self._joints.items()}

    def insist(self) -> None:
        self.send()

    def close(self) -> None:
        """Nothing is held open."""


class _Answers:
    """Answers received on a line so far: `words` by unit, empty if the unit accepted the stop."""

    def __init__(self, line: socket.socket) -> None:
        self.words: dict[int, str] = {}
        self._line = line
        self._data = b""

    def wait_for(self, units: Collection[int], seconds: float) -> None:
        """Read until all of these units have answered or the time is over. Raises OSError if the drives close
        the line.
        """
        deadline = time.monotonic() + seconds
        while not self.words.keys() >= set(units):
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
