"""The process around the cabinet: one thread that owns machine, nodes and sockets and takes things in order."""

import selectors
import socket
import time
from pathlib import Path

from simulator.can_bus import CanBus
from simulator.canopen.cabinet import Cabinet
from simulator.canopen.node import Frame
from simulator.control import ControlServer
from simulator.machine import Machine
from simulator.socketcand import SocketcandServer

_LONGEST_WAIT = 1.0  # s


class VirtualDrive:
    """A machine on a bus: socketcand at `host`:`port`, or any python-can interface; control port at `host`.

    Raises OSError or can.CanError if bus or port cannot be opened. `run` blocks until `stop`; `close` afterwards.
    """

    def __init__(
        self,
        machine: Machine,
        eds: Path,
        *,
        bus: str = "socketcand",
        channel: str = "can0",
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
        self._bus: SocketcandServer | CanBus
        self.cabinet = Cabinet(machine, eds, speed_factor, lambda frame: self._bus.send(frame))
        if bus == "socketcand":
            self._bus = SocketcandServer(self._selector, host, port, channel, self._receive)
        else:
            self._bus = CanBus(self._selector, bus, channel, self._receive)
        self._control = ControlServer(self._selector, host, control_port, self.cabinet)

    @property
    def port(self) -> int | None:
        """Of the socketcand server; None on any other bus."""
        return self._bus.port if isinstance(self._bus, SocketcandServer) else None

    @property
    def control_port(self) -> int:
        return self._control.port

    def run(self) -> None:
        """Power on and serve until `stop`."""
        self.cabinet.boot()
        while not self._stopping:
            now = time.monotonic()
            for key, mask in self._selector.select(min(self.cabinet.due(now), self._bus.due(now), _LONGEST_WAIT)):
                key.data(mask)
            now = time.monotonic()
            self._bus.run(now)
            self.cabinet.run(now)

    def stop(self) -> None:
        """End `run`; from any thread or signal handler."""
        self._stopping = True
        self._wake.send(b"\0")

    def close(self) -> None:
        """Release bus, ports and sockets."""
        self._control.close()
        self._bus.close()
        self._selector.close()
        self._wake.close()
        self._woken.close()

    def _awake(self, _: int) -> None:
        self._woken.recv(64)

    def _receive(self, frame: Frame) -> None:
        self.cabinet.receive(frame, time.monotonic())
