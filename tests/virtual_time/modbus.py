"""A Modbus TCP gateway in memory, and the virtual cabinet behind it. An answer takes what the seed draws.

The client of the service (`drivers.modbus.line`, pymodbus) and the stop sender open a connection to it: their modules
`socket` and `select` are those of this one, see `install`.
"""

import socket as real_socket
from collections.abc import Callable, Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Self

import pymodbus.client.tcp
from pymodbus.framer import FramerSocket
from pymodbus.pdu import DecodePDU

import drivers.modbus.line
import drivers.modbus.stop_sender
from simulator.machine import LiveMachine
from simulator.modbus.line import ModbusCabinet
from simulator.modbus.registers import RegisterLayout
from tests.virtual_time import primitives
from tests.virtual_time.cabinets import EventDriven, Powered
from tests.virtual_time.scheduler import SimThread

ANSWER = 2e-3  # s that the gateway takes to answer a request

Address = tuple[str, int]


class EventDrivenModbusCabinet(EventDriven, ModbusCabinet):
    """See `EventDriven`."""


class Gateway(Powered[EventDrivenModbusCabinet]):
    """Accepts any number of clients; answers a request after the other of each."""

    def __init__(
        self, address: Address, machine: LiveMachine, eds: Path, registers: RegisterLayout, speed: float
    ) -> None:
        self.gone = ""
        """"refused": what is open fails, nothing can be opened; "silent": nothing is answered, nothing fails."""
        self.lost: Callable[[bytes, bool], bool] = lambda _adu, _command: False
        """Which requests and which answers reach nobody."""
        self.address = address
        self._framer = FramerSocket(DecodePDU(True))
        self._connections: list[Connection] = []
        super().__init__(EventDrivenModbusCabinet(machine, eds, registers, speed))

    def cut(self) -> None:
        """It is gone, until `mend`."""
        self.gone = "refused"
        for connection in self._connections:
            connection.end("reset by the gateway")
        self._connections.clear()

    def mend(self) -> None:
        self.gone = ""

    def connect(self, timeout: float) -> "End":
        """OSError."""
        if timeout < 0:
            raise ValueError("Timeout value out of range")
        primitives.sleep(min(timeout, 2 * self.wire if self.gone != "silent" else timeout))
        if self.gone == "refused":
            raise ConnectionRefusedError("connection refused")
        if self.gone == "silent" or timeout < 2 * self.wire:
            raise TimeoutError("timed out")
        connection = Connection(self)
        self._connections.append(connection)
        return connection.host

    def asked(self, data: bytes, answer: Callable[[bytes], None]) -> int:
        """Bytes of a client have arrived; how many of them were used."""
        used, request = self._framer.handleFrame(data, 0, 0)
        if request is None:
            return used
        adu = data[:used]
        self.world.trace(f"> {adu.hex()}")
        if not self.switched_off and not self.cabinet.frozen and not self.gone and not self.lost(adu, True):
            now = self.world.now
            self.cabinet.run(now)
            response = self.cabinet.answer(request, now)
            self.acted()
            if response is not None:
                response.transaction_id, response.dev_id = request.transaction_id, request.dev_id
                reply = self._framer.buildFrame(response)
                if not self.lost(reply, False):
                    self.world.trace(f"< {reply.hex()}")
                    answer(reply)
        return used


class Connection:
    """Of a host with the gateway; it ends with the host's process."""

    def __init__(self, gateway: Gateway) -> None:
        self._gateway, self._world = gateway, gateway.world
        self.host = End(self._from_host)
        self._received = b""
        self._to_gateway = self._to_host = 0.0
        self._world.current.process.at_end.append(self.host.close)

    def end(self, why: str) -> None:
        self.host.end(why)

    def _from_host(self, data: bytes) -> None:
        self._to_gateway = max(self._to_gateway, self._world.now + self._gateway.delay())
        self._world.at(self._to_gateway, lambda: self._arrives(data))

    def _arrives(self, data: bytes) -> None:
        self._received += data
        while used := self._gateway.asked(self._received, self._from_gateway):
            self._received = self._received[used:]

    def _from_gateway(self, data: bytes) -> None:
        self._to_host = max(self._to_host, self._world.now + ANSWER + self._gateway.delay())
        self._world.at(self._to_host, lambda: self._reaches_host(data))

    def _reaches_host(self, data: bytes) -> None:
        if not self._gateway.gone:
            self.host.take(data)


class End:
    """What the product asks of `socket.socket`."""

    def __init__(self, send: Callable[[bytes], None]) -> None:
        self._send = send
        self._received = bytearray()
        self._ended: str | None = None  # why; "": regularly
        self._closed = False
        self.waiting: list[SimThread] = []

    def take(self, data: bytes) -> None:
        self._received += data
        self._wake()

    def end(self, why: str = "") -> None:
        """By the other side."""
        self._ended = why
        self._wake()

    @property
    def readable(self) -> bool:
        return bool(self._received) or self._ended is not None

    def send(self, data: bytes) -> int:
        if self._closed or self._ended is not None:
            raise BrokenPipeError(self._ended or "closed")
        self._send(bytes(data))
        primitives.world.point()
        return len(data)

    sendall = send

    def recv(self, most: int) -> bytes:
        if self._closed:
            raise OSError("closed")
        if not self._received and self._ended:
            raise ConnectionResetError(self._ended)
        data = bytes(self._received[:most])
        del self._received[:most]
        return data

    def close(self) -> None:
        self._closed = True
        self._wake()

    def setsockopt(self, *_: object) -> None:
        pass

    def setblocking(self, _: bool) -> None:
        pass

    def getsockname(self) -> str:
        return "virtual time"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _wake(self) -> None:
        for thread in self.waiting:
            primitives.world.wake(thread)


def _pair() -> tuple[End, End]:
    one, other = End(lambda data: other.take(data)), End(lambda data: one.take(data))
    return one, other


def _select(read: Iterable[End], _write: object, _error: object, timeout: float) -> tuple[list[End], ...]:
    world, ends = primitives.world, [*read]
    deadline, me = world.now + max(0.0, timeout), world.current
    world.point()
    while not (ready := [end for end in ends if end.readable]):
        for end in ends:
            end.waiting.append(me)
        went_on = world.wait("bytes of a connection", deadline)
        for end in ends:
            end.waiting.remove(me)
        if not went_on:
            ready = [end for end in ends if end.readable]
            break
    return ready, [], []


GATEWAYS: dict[Address, Gateway] = {}


def _create_connection(address: Address, timeout: float = 60.0, *_: object, **__: object) -> End:
    gateway = GATEWAYS.get(address)
    if gateway is None:
        raise ConnectionRefusedError("nobody listens")
    return gateway.connect(timeout)


def install() -> None:
    """For this process: connections of the Modbus drivers lead to `GATEWAYS`."""
    names = {name: getattr(real_socket, name) for name in dir(real_socket) if name.isupper()}
    network = SimpleNamespace(**names, create_connection=_create_connection, socketpair=_pair, socket=End)
    waiting = SimpleNamespace(select=_select)
    modules: tuple[Any, ...] = (drivers.modbus.line, drivers.modbus.stop_sender, pymodbus.client.tcp)
    for module in modules:
        module.socket, module.select = network, waiting
