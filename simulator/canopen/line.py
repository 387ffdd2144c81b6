"""The cabinet on its CAN bus: a socketcand server here, or any python-can interface.

Sockets do not block and are served by the owner's selector, so everything happens in the owner's thread.
"""

import drivers.lean_can  # noqa: F401  # pyright: ignore[reportUnusedImport]

# isort: split
import re
import selectors
import socket
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from math import inf, tau
from pathlib import Path
from threading import Event, Thread
from typing import Any, NamedTuple, cast

import can
import structlog
from can.interfaces.socketcan import SocketcanBus

from simulator.cabinet import DriveCabinet, VirtualDriveCabinet, joint_limits
from simulator.canopen.node import ForeignNode, VirtualNode
from simulator.canopen.pdo import Frame
from simulator.drive.foreign_axis import ForeignAxis, MotorPlate
from simulator.drive.power_drive import Mode
from simulator.drive.virtual_axis import VirtualAxis
from simulator.machine import AxisInfo, LiveMachine
from simulator.scenario import ScenarioError


class CanopenCabinet(VirtualDriveCabinet[VirtualNode]):
    """Virtual drives: node ids 1, 2, ... in the order of the machine's joints. The period of SYNC is 1006h."""

    def __init__(self, machine: LiveMachine, eds: Path, speed_factor: float, send: Callable[[Frame], None]) -> None:
        nodes = {
            info.joint: VirtualNode(number, eds, machine.cycle, send, can_move=not info.locked)
            for number, info in enumerate(machine.axes, 1)
        }
        super().__init__(machine, nodes, speed_factor)

    def receive(self, frame: Frame, now: float) -> None:
        """A frame of the bus at `now`, s of a monotonic clock."""
        if frame.id == 0x80:
            for node in self.nodes.values():
                node.sync(now)
            self.switch()
            leader = next((node for node in self.nodes.values() if node.axis.interpolating), None)
            if leader is not None:
                self.advance(round(leader.dictionary[0x1006, 0] * 1e-6 / self._machine.cycle))
        else:
            for node in self.nodes.values():
                node.receive(frame, now)
        self.switch()

    def status(self) -> dict[str, object]:
        """As on any fieldbus, and the SYNC counter."""
        counter = max(node.dictionary[0x2120, 1] for node in self.nodes.values())
        return super().status() | {"sync_counter": counter}

    def axis_status(self, info: AxisInfo, axis: VirtualAxis) -> dict[str, object]:
        """As on any fieldbus, and the NMT state of the node."""
        return super().axis_status(info, axis) | {"nmt": self.nodes[info.joint].nmt.name.lower()}


class ForeignCabinet(DriveCabinet[ForeignNode]):
    """Drives of other makers: node ids as above; `files`: the EDS or DCF of each joint's drive.

    The period of SYNC is 1006h, else 60C2h, else as measured. If SYNC is missing, real time is the clock, as for a real
    axis. Raises ScenarioError for a joint without a file, or a file of another kind.
    """

    sync_lost = 5.0
    """s after the last SYNC, from which the machine continues in real time."""

    def __init__(
        self, machine: LiveMachine, files: Mapping[str, Path], speed_factor: float, send: Callable[[Frame], None]
    ) -> None:
        limits = joint_limits(machine.scenario.robot.urdf)
        nodes: dict[str, ForeignNode] = {}
        for number, info in enumerate(machine.axes, 1):
            if info.joint not in files:
                raise ScenarioError(f"joint {info.joint}: no dictionary for its drive")
            plate = _plate(info, limits[info.joint])
            file, can_move = files[info.joint], not info.locked
            nodes[info.joint] = ForeignNode(number, file, plate, machine.cycle, send, can_move=can_move)
        super().__init__(machine, nodes, speed_factor)

    def receive(self, frame: Frame, now: float) -> None:
        """A frame of the bus at `now`, s of a monotonic clock."""
        self._now = now
        synced = [node for node in self.nodes.values() if frame.id == node.sync_id]
        for node in synced:
            node.sync(frame.data, now)
        self.switch()
        leader = next((node for node in synced if node.led_by_sync), None)
        if leader is not None:
            self.advance(leader.sync_cycles)
        for node in self.nodes.values():
            if node not in synced:
                node.receive(frame, now)
        self.switch()

    def due(self, now: float) -> float:
        lost = inf
        if self._pace()[0] == 0.0:
            lost = min(
                (node.synced_at + self.sync_lost for node in self.nodes.values() if node.led_by_sync), default=inf
            )
        return min(super().due(now), max(lost - now, 0.0))

    def axis_status(self, info: AxisInfo, axis: ForeignAxis) -> dict[str, object]:
        """Status of one axis; `effort` is the true torque of the motor, N m on the joint side."""
        node = self.nodes[info.joint]
        return super().axis_status(info, axis) | {
            "effort": axis.torque * info.gear_ratio,
            "nmt": node.nmt.name.lower(),
            "maker": node.dictionary.maker.name,
        }

    def _pace(self) -> tuple[float, int]:
        axes = [axis for _, axis in self._axes if axis.energised]
        synced = any(n.led_by_sync and self._now - n.synced_at < self.sync_lost for n in self.nodes.values())
        if not axes or synced:
            return 0.0, 1
        moving = [axis for axis in axes if axis.moving]
        return self._paced(moves=bool(moving), at_speed=all(axis.mode is Mode.PROFILE_POSITION for axis in moving))

    def _torque_limit(self, info: AxisInfo, axis: ForeignAxis) -> float:
        return axis.torque_limit * abs(info.gear_ratio)


def _plate(info: AxisInfo, limits: Mapping[str, float]) -> MotorPlate:
    turns = info.gear_ratio / tau
    ends = sorted((limits["lower"] * turns, limits["upper"] * turns))
    rated = info.rated_effort / abs(info.gear_ratio)
    return MotorPlate(
        gear_ratio=info.gear_ratio,
        rated_torque=rated,
        most_torque=info.effort_limit / abs(info.gear_ratio),
        torque_constant=rated / 10.0,  # A at rated torque, for every motor
        most_speed=limits["velocity"] * abs(turns),
        window=(ends[0], ends[1]),
    )


_log = structlog.get_logger(__name__)


class CanBus:
    """Any python-can `interface` with its `channel`, read by the owner's selector. Raises can.CanError or OSError if it
    cannot be opened.

    A kernel bus has a file descriptor and is read directly: each thread between a frame and its node would delay the
    drive.
    """

    def __init__(
        self, selector: selectors.BaseSelector, interface: str, channel: str, receive: Callable[[Frame], None]
    ) -> None:
        self._selector = selector
        self._receive = receive
        self._bus = cast(Any, can.Bus)(interface=interface, channel=channel)
        if isinstance(self._bus, SocketcanBus):
            _widen(self._bus.socket)
            self._inbox: SocketcanBus | _Inbox = self._bus
        else:
            self._inbox = _Inbox(self._bus, f"can {interface} {channel}")
        self._off = False
        self._lost = False
        selector.register(self._inbox.fileno(), selectors.EVENT_READ, self._deliver)

    def send(self, frame: Frame) -> None:
        """Send a frame; it is lost if the bus does not accept it (bus-off, queue full)."""
        if not self._off:
            self._put(can.Message(arbitration_id=frame.id, data=frame.data, is_extended_id=False))

    def switch_off(self, *, off: bool) -> None:
        """Bus-off: sends an error frame, then no frame passes in either direction until it is switched on."""
        if off and not self._off:
            self._put(can.Message(arbitration_id=0x40, data=bytes(8), is_error_frame=True))  # SocketCAN's error class
        self._off = off

    def due(self, now: float) -> float:
        """Infinity: nothing is buffered."""
        del now
        return float("inf")

    def run(self, now: float) -> None:
        """Nothing to do: nothing is buffered."""

    def close(self) -> None:
        self._unregister()
        if isinstance(self._inbox, _Inbox):
            self._inbox.close()
        self._bus.shutdown()

    def _put(self, message: can.Message) -> None:
        try:
            self._bus.send(message)
        except can.CanError as error:
            _log.warning("frame lost", identifier=hex(message.arbitration_id), error=str(error))

    def _deliver(self, _: int) -> None:
        for _ in range(64):  # frames processed before the timers are served
            try:
                message = self._inbox.recv(0.0)
            except can.CanError as error:
                _log.error("bus lost", error=str(error))
                self._unregister()
                return
            if message is None:
                return
            foreign = message.is_extended_id or message.is_error_frame or message.is_remote_frame
            if not (foreign or self._off):
                self._receive(Frame(message.arbitration_id, bytes(message.data)))

    def _unregister(self) -> None:
        if not self._lost:
            self._lost = True
            self._selector.unregister(self._inbox.fileno())


class _Inbox:
    """Frames of a bus that a selector cannot wait for: a thread receives them, and a socket signals them."""

    def __init__(self, bus: can.BusABC, name: str) -> None:
        self._bus = bus
        self._messages: deque[can.Message] = deque()
        self._error: can.CanError | None = None
        self._wake, self._woken = socket.socketpair()
        self._woken.setblocking(False)
        self._closing = Event()
        self._thread = Thread(target=self._fetch, name=name, daemon=True)
        self._thread.start()

    def fileno(self) -> int:
        """Readable while frames wait."""
        return self._woken.fileno()

    def recv(self, _timeout: float) -> can.Message | None:
        """The next frame, None if there is none; after the last frame it raises the error that ended the bus."""
        with suppress(BlockingIOError):
            self._woken.recv(1)  # one byte per frame
        if self._messages:
            return self._messages.popleft()
        if self._error is not None:
            raise self._error
        return None

    def close(self) -> None:
        """End the thread; the bus stays open."""
        self._closing.set()
        self._thread.join()
        self._woken.close()
        self._wake.close()

    def _fetch(self) -> None:
        while not self._closing.is_set():
            try:
                message = self._bus.recv(0.1)
            except can.CanError as error:
                self._error = error
                self._wake.send(b"\0")
                return
            if message is not None:
                self._messages.append(message)
                self._wake.send(b"\0")


def _widen(receiving: socket.socket) -> None:
    """Set the receive buffer to the largest size that the kernel allows: no SYNC is lost while the computer is busy for
    a second.
    """
    size, forced = 1 << 22, 33  # bytes; SO_RCVBUFFORCE of Linux exceeds the kernel's limit for privileged processes
    receiving.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, size)
    with suppress(OSError):  # needs CAP_NET_ADMIN
        receiving.setsockopt(socket.SOL_SOCKET, forced, size)


class SentFrame(NamedTuple):
    """A frame from a client, with 11-bit or (`extended`) 29-bit identifier."""

    frame: Frame
    extended: bool


def parse_send(identifier: str, length: str, data: Sequence[str]) -> SentFrame | None:
    """The words of a ``send``: hex identifier (extended: more than 3 digits), length, data bytes; None if it is no
    frame.
    """
    if not re.fullmatch("[0-9A-Fa-f]{1,8}", identifier):
        return None
    if not all(re.fullmatch("[0-9A-Fa-f]{1,2}", word) for word in (length, *data)):
        return None
    number, extended = int(identifier, 16), len(identifier) > 3
    if len(data) > 8 or int(length, 16) != len(data) or number > (0x1FFFFFFF if extended else 0x7FF):
        return None
    return SentFrame(Frame(number, bytes(int(byte, 16) for byte in data)), extended)


@dataclass(eq=False, slots=True)
class _Client:
    """One connection: ``hi`` sent, channel open, raw mode (on the bus)."""

    connection: socket.socket
    received: bytearray = field(default_factory=bytearray)
    unsent: bytearray = field(default_factory=bytearray)
    full: bool = False  # it does not read: nothing is sent until it can be written to
    opened: bool = False
    raw: bool = False
    joining: float = 0.0
    """Until then frames are buffered: python-can treats data directly after the last ``< ok >`` as an error."""


class SocketcandServer:
    """The bus as lines ``< ... >`` over TCP (raw mode only), shared by several clients.

        client: < open can0 >   < rawmode >   < send 201 2 f 0 >   < echo >
        server: < hi >  < ok >  < ok >        < frame 181 12.345678 3702 >   < error 040 12.345678 >

    A frame sent by one client goes to `receive` and to the other clients; `send` reaches all of them. Serves `channel`
    on `host`:`port` (0: a free one). Raises OSError if the port is taken.
    """

    def __init__(
        self, selector: selectors.BaseSelector, host: str, port: int, channel: str, receive: Callable[[Frame], None]
    ) -> None:
        self._selector = selector
        self._channel = channel
        self._receive = receive
        self._clients: list[_Client] = []
        self._off = False
        self._listener = socket.create_server((host, port))
        self._listener.setblocking(False)
        self.port: int = self._listener.getsockname()[1]
        selector.register(self._listener, selectors.EVENT_READ, self._accept)

    def send(self, frame: Frame) -> None:
        if not self._off:
            self._broadcast(frame, None)

    def switch_off(self, *, off: bool) -> None:
        """Bus-off: sends an error frame, then no frame passes in either direction until it is switched on."""
        if off and not self._off:
            self._tell(f"< error 040 {time.time():.6f} >", None)
        self._off = off

    def close(self) -> None:
        """Disconnect every client and close the port."""
        for client in list(self._clients):
            self._drop(client, "server closes")
        self._selector.unregister(self._listener)
        self._listener.close()

    def due(self, now: float) -> float:
        """Seconds until buffered frames must be sent; infinity if there are none."""
        waiting = (client.joining for client in self._clients if client.unsent and not client.full)
        return max(min(waiting, default=float("inf")) - now, 0.0)

    def run(self, now: float) -> None:
        """Send what was written since the last call: one packet for many frames."""
        for client in list(self._clients):
            if client.unsent and not client.full and now >= client.joining:
                self._flush(client)

    def _accept(self, _: int) -> None:
        connection, address = self._listener.accept()
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        client = _Client(connection)
        self._clients.append(client)
        self._selector.register(connection, selectors.EVENT_READ, partial(self._serve, client))
        _log.info("client connected", address=address)
        self._write(client, b"< hi >")

    def _serve(self, client: _Client, mask: int) -> None:
        if mask & selectors.EVENT_WRITE:
            self._flush(client)
        if mask & selectors.EVENT_READ and client in self._clients:
            self._read(client)

    def _read(self, client: _Client) -> None:
        try:
            data = client.connection.recv(65536)
        except BlockingIOError:
            return
        except OSError as error:
            self._drop(client, str(error))
            return
        if not data:
            self._drop(client, "closed by the client")
            return
        client.received += data
        *lines, rest = client.received.split(b">")
        client.received = bytearray(rest)
        if len(rest) > 256:
            self._drop(client, "not the socketcand protocol")
            return
        for line in lines:
            self._command(client, line.decode("ascii", "replace").replace("<", "", 1).split())

    def _command(self, client: _Client, words: list[str]) -> None:
        if client not in self._clients:
            return
        match words:
            case ["open", channel] if channel == self._channel:
                client.opened = True
                self._write(client, b"< ok >")
            case ["open", channel]:
                self._write(client, b"< error no channel " + channel.encode("ascii", "replace") + b" here >")
            case ["rawmode"] if client.opened:
                client.raw = True
                self._write(client, b"< ok >")
                self._flush(client)
                client.joining = time.monotonic() + 0.02
            case ["echo"]:
                self._write(client, b"< echo >")
            case ["send", identifier, length, *data] if client.raw:
                client.joining = 0.0
                self._take(client, identifier, length, data)
            case _:
                self._write(client, b"< error unknown command >")

    def _take(self, client: _Client, identifier: str, length: str, data: list[str]) -> None:
        sent = parse_send(identifier, length, data)
        if sent is None:
            self._write(client, b"< error could not parse frame >")
        elif not self._off:
            self._broadcast(sent.frame, client, extended=sent.extended)
            if not sent.extended:
                self._receive(sent.frame)

    def _broadcast(self, frame: Frame, sender: _Client | None, *, extended: bool = False) -> None:
        width = 8 if extended else 3
        self._tell(f"< frame {frame.id:0{width}X} {time.time():.6f} {frame.data.hex().upper()} >", sender)

    def _tell(self, line: str, sender: _Client | None) -> None:
        for client in list(self._clients):
            if client.raw and client is not sender:
                self._write(client, line.encode())

    def _write(self, client: _Client, data: bytes) -> None:
        client.unsent += data
        if len(client.unsent) > 1 << 20:  # bytes a client may leave unread
            self._drop(client, "does not read")

    def _flush(self, client: _Client) -> None:
        try:
            sent = client.connection.send(client.unsent)
        except BlockingIOError:
            sent = 0
        except OSError as error:
            self._drop(client, str(error))
            return
        del client.unsent[:sent]
        full = bool(client.unsent)
        if full is not client.full:
            client.full = full
            self._listen(client, selectors.EVENT_READ | (selectors.EVENT_WRITE if full else 0))

    def _listen(self, client: _Client, events: int) -> None:
        self._selector.modify(client.connection, events, partial(self._serve, client))

    def _drop(self, client: _Client, reason: str) -> None:
        if client in self._clients:
            self._clients.remove(client)
            self._selector.unregister(client.connection)
            client.connection.close()
            _log.info("client dropped", reason=reason)


class CanLine:
    """`bus`: "socketcand" at `host`:`port`, or python-can's name. Raises OSError or can.CanError if it cannot open.

    `eds`: the dictionary of the virtual drive; a mapping gives each joint a drive of another manufacturer.
    """

    device = None

    def __init__(
        self,
        selector: selectors.BaseSelector,
        machine: LiveMachine,
        eds: Path | Mapping[str, Path],
        speed_factor: float,
        *,
        bus: str,
        channel: str,
        host: str,
        port: int,
    ) -> None:
        self.bus: SocketcandServer | CanBus
        self.cabinet: CanopenCabinet | ForeignCabinet
        if isinstance(eds, Path):
            self.cabinet = CanopenCabinet(machine, eds, speed_factor, lambda frame: self.bus.send(frame))
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
        self.bus.run(now)

    def close(self) -> None:
        self.bus.close()

    def _receive(self, frame: Frame) -> None:
        self.cabinet.receive(frame, time.monotonic())
