"""The process around the cabinet: one thread that owns machine, nodes and sockets and takes things in order."""

import selectors
import socket
import time
from collections.abc import Mapping
from enum import Enum
from pathlib import Path

from simulator.canopen.line import CanLine
from simulator.control import ControlServer
from simulator.machine import Machine
from simulator.modbus.line import PTY, ModbusLine
from simulator.modbus.register_map import RegisterMap
from simulator.modbus.server import SerialLine, TcpLine

_LONGEST_WAIT = 1.0  # s


class Fieldbus(Enum):
    """What the virtual machine speaks."""

    CANOPEN = "canopen"
    MODBUS_TCP = "modbus-tcp"
    MODBUS_RTU = "modbus-rtu"


class VirtualDrive:
    """A machine on a fieldbus, and its control port at `host`. `run` blocks until `stop`; `close` afterwards.

    CANopen: socketcand at `host`:`port`, or any other python-can interface `bus` with its `channel`. Modbus, by the
    map `registers`: TCP at `host`:`port`, RTU at the serial `device` ("pty": a pseudo-terminal made here). `eds` by
    joint: drives of other makers, on CANopen alone. Raises OSError or can.CanError if line or port cannot be opened,
    ScenarioError for an EDS that this drive cannot have.
    """

    def __init__(
        self,
        machine: Machine,
        eds: Path | Mapping[str, Path],
        *,
        fieldbus: Fieldbus = Fieldbus.CANOPEN,
        bus: str = "socketcand",
        channel: str = "can0",
        registers: RegisterMap | None = None,
        device: str = PTY,
        host: str = "127.0.0.1",
        port: int = 0,
        control_port: int = 0,
        speed_factor: float = 1.0,
    ) -> None:
        # select(2) waits by the microsecond; epoll's milliseconds are 20 ms of a machine at factor 20.
        self._selector = selectors.SelectSelector()
        self._wake, self._woken = socket.socketpair()
        self._stopping = False
        self._selector.register(self._woken, selectors.EVENT_READ, self._awake)
        self._line: CanLine | ModbusLine
        if fieldbus is Fieldbus.CANOPEN:
            self._line = CanLine(
                self._selector, machine, eds, speed_factor, bus=bus, channel=channel, host=host, port=port
            )
        elif registers is None or not isinstance(eds, Path):
            raise ValueError("registers, eds: Modbus needs a register map and the virtual drive's own EDS")
        else:
            line = TcpLine(host, port) if fieldbus is Fieldbus.MODBUS_TCP else SerialLine(device)
            self._line = ModbusLine(self._selector, machine, eds, speed_factor, registers=registers, line=line)
        self.cabinet = self._line.cabinet
        self._control = ControlServer(self._selector, host, control_port, self.cabinet, self._line.bus)

    @property
    def port(self) -> int | None:
        """Of the socketcand or Modbus TCP server; None on any other line."""
        return self._line.port

    @property
    def device(self) -> str | None:
        """Where the host finds a serial line; None on any other."""
        return self._line.device

    @property
    def control_port(self) -> int:
        return self._control.port

    def run(self) -> None:
        """Power on and serve until `stop`."""
        self.cabinet.boot()
        while not self._stopping:
            now = time.monotonic()
            for key, mask in self._selector.select(min(self.cabinet.due(now), self._line.due(now), _LONGEST_WAIT)):
                key.data(mask)
            now = time.monotonic()
            self._line.run(now)
            self.cabinet.run(now)

    def stop(self) -> None:
        """End `run`; from any thread or signal handler."""
        self._stopping = True
        self._wake.send(b"\0")

    def close(self) -> None:
        """Release line, ports and sockets."""
        self._control.close()
        self._line.close()
        self._selector.close()
        self._wake.close()
        self._woken.close()

    def _awake(self, _: int) -> None:
        self._woken.recv(64)
