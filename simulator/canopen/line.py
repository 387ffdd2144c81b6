"""The cabinet on its CAN bus: the socketcand server here, or any python-can interface."""

import selectors
import time
from collections.abc import Mapping
from pathlib import Path

from simulator.can_bus import CanBus
from simulator.canopen.cabinet import Cabinet
from simulator.canopen.node import Frame
from simulator.foreign.cabinet import ForeignCabinet
from simulator.machine import Machine
from simulator.socketcand import SocketcandServer


class CanLine:
    """`bus`: "socketcand" at `host`:`port`, or python-can's name. Raises OSError or can.CanError if it cannot open.

    `eds`: the dictionary of the virtual drive; a mapping gives each joint a drive of another manufacturer.
    """

    device = None

    def __init__(
        self,
        selector: selectors.BaseSelector,
        machine: Machine,
        eds: Path | Mapping[str, Path],
        speed_factor: float,
        *,
        bus: str,
        channel: str,
        host: str,
        port: int,
    ) -> None:
        self.bus: SocketcandServer | CanBus
        self.cabinet: Cabinet | ForeignCabinet
        if isinstance(eds, Path):
            self.cabinet = Cabinet(machine, eds, speed_factor, lambda frame: self.bus.send(frame))
        else:
            self.cabinet = ForeignCabinet(machine, eds, speed_factor, lambda frame: self.bus.send(frame))
        if bus == "socketcand":
            self.bus = SocketcandServer(selector, host, port, channel, self._receive)
        else:
            self.bus = CanBus(selector, bus, channel, self._receive)

    @property
    def port(self) -> int | None:
        """Port of the socketcand server; None on any other bus."""
        return self.bus.port if isinstance(self.bus, SocketcandServer) else None

    def due(self, now: float) -> float:
        """Seconds from `now` until `run` must be called; infinity if never."""
        return self.bus.due(now)

    def run(self, now: float) -> None:
        """Send buffered frames."""
        self.bus.run(now)

    def close(self) -> None:
        """Release the bus."""
        self.bus.close()

    def _receive(self, frame: Frame) -> None:
        self.cabinet.receive(frame, time.monotonic())
