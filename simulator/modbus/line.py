"""The cabinet on its Modbus line: TCP, a serial device, or a pseudo-terminal created here."""

import selectors
import time
from math import inf
from pathlib import Path

from pymodbus.pdu import ModbusPDU

from simulator.machine import Machine
from simulator.modbus.cabinet import ModbusCabinet
from simulator.modbus.pty_pair import PTY, PtyPair
from simulator.modbus.register_map import RegisterMap
from simulator.modbus.server import ModbusServer, SerialLine, TcpLine

"""Device of a serial line that is created here."""


class ModbusLine:
    """Raises OSError if the line cannot be opened. `device`: the path of the serial line for the host."""

    bus = None

    def __init__(
        self,
        selector: selectors.BaseSelector,
        machine: Machine,
        eds: Path,
        speed_factor: float,
        *,
        registers: RegisterMap,
        line: TcpLine | SerialLine,
    ) -> None:
        self.cabinet = ModbusCabinet(machine, eds, registers, speed_factor)
        self._pair: PtyPair | None = None
        self.device: str | None = None
        if isinstance(line, SerialLine):
            self.device = line.device
            if line.device == PTY:
                self._pair = PtyPair(selector)
                self.device, line = self._pair.far, SerialLine(self._pair.near)
        self._server = ModbusServer(selector, line, self._answer)
        self.port = self._server.port

    def due(self, now: float) -> float:
        """Infinity: nothing is buffered."""
        del now
        return inf

    def run(self, now: float) -> None:
        """Nothing to do: nothing is buffered."""

    def close(self) -> None:
        """Release the line."""
        self._server.close()
        if self._pair is not None:
            self._pair.close()

    def _answer(self, request: ModbusPDU) -> ModbusPDU | None:
        return self.cabinet.answer(request, time.monotonic())
