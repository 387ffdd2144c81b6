"""A CAN bus in memory, and the virtual cabinet on it. A frame takes what the seed draws; nothing is polled.

Hosts reach it as "socketcan": by python-can (the service) and by a raw socket (the stop process), see `install`.
"""

import errno
import queue
import socket as real_socket
import struct
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import can
import can.interface

import drivers.canopen.stop_sender
from simulator.canopen.line import CanopenCabinet
from simulator.canopen.pdo import Frame
from simulator.machine import LiveMachine
from tests.virtual_time import primitives
from tests.virtual_time.cabinets import EventDriven, Powered
from tests.virtual_time.primitives import SimpleQueue

ANSWER = 1e-3  # s that a drive takes to answer a request (SDO)
_BUS_OFF, _SDO_ANSWER = 0x40, 0x580
_VELOCITY = bytes.fromhex("6c60")  # 606Ch, as it stands in a frame
_ERROR_FLAG = 0x20000000  # linux/can.h
_CAN = {"AF_CAN": 29, "CAN_RAW": 1, "SOL_CAN_RAW": 101, "CAN_RAW_FILTER": 1}  # linux/can.h; not every platform has it
_CAN_FRAME = struct.Struct("=IB3x8s")  # linux/can.h


class EventDrivenCabinet(EventDriven, CanopenCabinet):
    """See `EventDriven`."""


class Wire(Powered[EventDrivenCabinet]):
    """The bus, the cabinet on it, and its hosts. Frames from one sender reach each receiver in their order."""

    wire = 120e-6  # s that a frame takes on the wire at 1 Mbit/s

    def __init__(self, channel: str, machine: LiveMachine, eds: Path, speed_factor: float) -> None:
        self.channel = channel
        self.gone = False
        """The gateway to the bus, or the interface, is not there: what is open fails, nothing can be opened."""
        self.lost: Callable[[int, bytes], bool] = lambda _identifier, _data: False
        """Which frames reach nobody."""
        self.hosts: list[Host] = []
        self.answered: dict[int, float] = {}
        """When a node told its velocity last, s: a look at its state alone says nothing of standstill."""
        self._reaches_cabinet = 0.0
        self.world = primitives.world
        self.switched_off = False  # the nodes already say something while the base class boots them
        super().__init__(EventDrivenCabinet(machine, eds, speed_factor, self._sent_by_cabinet))

    # -- what may go wrong

    def switch_off(self, *, off: bool) -> None:
        """Bus-off: an error frame, then nothing passes in either direction until it is switched on."""
        if off and not self.switched_off:
            self._to_hosts(_BUS_OFF, bytes(8), error=True)
        super().switch_off(off=off)

    def cut(self) -> None:
        """The gateway is gone, until `mend`."""
        self.gone = True
        for host in self.hosts:
            host.inbox.put_nowait(None)

    def mend(self) -> None:
        self.gone = False
        for host in [*self.hosts]:
            host.close()

    # -- frames

    def send(self, identifier: int, data: bytes, sender: "Host") -> None:
        """A host sends a frame. OSError if the interface is gone."""
        if self.gone or sender not in self.hosts:
            raise OSError(errno.ENETDOWN, "the interface is down")
        self.world.trace(f"> {identifier:03x} {data.hex()}")
        if self.switched_off or self.lost(identifier, data):
            return
        for host in self.hosts:
            if host is not sender:
                host.hear(identifier, data, self.delay())
        frame = Frame(identifier, data)
        self._reaches_cabinet = max(self._reaches_cabinet, self.world.now + self.delay())
        self.world.at(self._reaches_cabinet, lambda: self._arrives(frame))
        self.world.point()

    def _arrives(self, frame: Frame) -> None:
        if not self._closed and not self.switched_off and not self.cabinet.frozen:
            now = self.world.now
            self.cabinet.run(now)
            self.cabinet.receive(frame, now)
            self.cabinet.run(now)
            self._plan()

    def _sent_by_cabinet(self, frame: Frame) -> None:
        if not self.switched_off and not self.gone and not self.lost(frame.id, frame.data):
            if frame.id & ~0x7F == _SDO_ANSWER and frame.data[1:3] == _VELOCITY:
                self.answered[frame.id & 0x7F] = self.world.now
            self._to_hosts(frame.id, frame.data)

    def _to_hosts(self, identifier: int, data: bytes, error: bool = False) -> None:
        self.world.trace(f"< {identifier:03x} {data.hex()}")
        for host in self.hosts:
            host.hear(identifier, data, self.delay() + ANSWER * (identifier & ~0x7F == _SDO_ANSWER), error)


class Host:
    """One connection of a program to the bus; it closes with its process."""

    def __init__(self, wire: Wire, only: frozenset[int] = frozenset()) -> None:
        """`only`: a filter of the kernel for data frames, identifiers without their node; empty: all."""
        self.only = only
        self.inbox = SimpleQueue()  # (identifier, data, whether it is an error frame), or None: the interface is gone
        self._wire = wire
        self._last = 0.0
        wire.hosts.append(self)
        primitives.world.current.process.at_end.append(self.close)

    def hear(self, identifier: int, data: bytes, delay: float, error: bool = False) -> None:
        if self.only and identifier & ~0x7F not in self.only and not error:
            return
        self._last = max(self._last, primitives.world.now + delay)
        primitives.world.at(self._last, lambda: self.inbox.put_nowait((identifier, data, error)))

    def send(self, identifier: int, data: bytes) -> None:
        self._wire.send(identifier, data, self)

    def close(self) -> None:
        if self in self._wire.hosts:
            self._wire.hosts.remove(self)


WIRES: dict[str, Wire] = {}


def _wire(channel: str) -> Wire:
    wire = WIRES.get(channel)
    if wire is None or wire.gone:
        raise OSError(errno.ENODEV, f"no interface {channel}")
    return wire


class VirtualCan(can.BusABC):
    """python-can's view of the bus."""

    def __init__(self, channel: Any, **_: object) -> None:
        self._host = Host(_wire(channel))
        self.channel_info = f"virtual time {channel}"
        super().__init__(channel=channel)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        try:
            self._host.send(msg.arbitration_id, bytes(msg.data))
        except OSError as error:
            raise can.CanOperationError(str(error)) from None

    def recv(self, timeout: float | None = None) -> can.Message | None:
        try:
            heard = self._host.inbox.get(timeout=timeout)
        except queue.Empty:
            return None
        if heard is None:
            raise can.CanOperationError("the interface is down")
        identifier, data, error = heard
        return can.Message(
            arbitration_id=identifier,
            data=data,
            is_extended_id=False,
            is_error_frame=error,
            timestamp=primitives.wall(),
        )

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        return self.recv(timeout), True

    def shutdown(self) -> None:
        self._host.close()
        super().shutdown()


class RawSocket:
    """What the stop process opens: a CAN_RAW socket with a filter; it receives error frames in any case."""

    def __init__(self, *_: object) -> None:
        self._host: Host | None = None
        self._only: frozenset[int] = frozenset()

    def setsockopt(self, _level: int, option: int, value: object) -> None:
        if option == _CAN["CAN_RAW_FILTER"] and isinstance(value, bytes):
            self._only = frozenset(identifier for identifier, _mask in struct.iter_unpack("=II", value))

    def settimeout(self, _: float) -> None:
        pass

    def bind(self, address: tuple[str]) -> None:
        self._host = Host(_wire(address[0]), self._only)

    def sendall(self, data: bytes) -> None:
        identifier, length, content = _CAN_FRAME.unpack(data)
        self.host.send(identifier, content[:length])

    def recv(self, _: int) -> bytes:
        heard = self.host.inbox.get()
        if heard is None:
            raise OSError(errno.ENETDOWN, "the interface is down")
        identifier, data, error = heard
        return _CAN_FRAME.pack(identifier | _ERROR_FLAG * error, len(data), data)

    def wait(self, timeout: float) -> bool:
        """Whether a frame can be received."""
        try:
            heard = self.host.inbox.get(timeout=timeout)
        except queue.Empty:
            return False
        self.host.inbox.give_back(heard)
        return True

    @property
    def host(self) -> Host:
        if self._host is None:
            raise ValueError("not bound, or closed")
        return self._host

    def close(self) -> None:
        if self._host is not None:
            self._host.close()
            self._host = None


def _select(read: list[RawSocket], _write: object, _error: object, timeout: float) -> tuple[list[RawSocket], ...]:
    (only,) = read
    return ([only] if only.wait(timeout) else []), [], []


def install() -> None:
    """For this process: "socketcan" is a bus of `WIRES`."""
    backends: dict[str, tuple[str, str]] = vars(can.interface)["BACKENDS"]
    backends["socketcan"] = (__name__, VirtualCan.__name__)
    sender: Any = drivers.canopen.stop_sender
    names = {name: getattr(real_socket, name) for name in dir(real_socket) if name.isupper()}
    sender.socket = SimpleNamespace(**names | _CAN, socket=RawSocket, create_connection=None)
    sender.select = SimpleNamespace(select=_select)
