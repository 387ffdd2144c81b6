"""One CAN bus: a receiving thread that sorts frames, and the latest state of every node.

The notifier of canopen is not used: it drops error frames, and its thread ends silently when the interface fails.

Set-points timed by the kernel: one job of SocketCAN's broadcast manager (linux/can/bcm.h, net/can/bcm.c).

The job is a ring of at most 256 frames. The kernel sends one frame per interval. A cycle of n set-points and SYNC
has n + 1 frames with the interval T / (n + 1), so their order is fixed. (Two jobs would drift apart: the kernel
counts an interval from the moment at which it woke up, not from the planned moment.) For the same reason the
interval is controlled: at each refill it is adjusted so that SYNC keeps to a grid of T on the monotonic clock.

SETTIMER without STARTTIMER sets frames, count and interval, and does not change the running timer or the position in
the ring. The count ends the job: if the host hangs, the kernel sends the planned cycles, then a few cycles of quick
stop, then nothing.
"""

import logging
import queue
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from enum import IntFlag
from pathlib import Path
from typing import Any, ClassVar, cast

import can
import canopen
from can.interfaces.socketcan import SocketcanBus
from can.interfaces.socketcand import SocketCanDaemonBus
from canopen.sdo.client import SdoClient

from drivers.canopen import frames
from drivers.canopen.profile import BusProfile
from drivers.canopen.sdo import RemoteNode
from drivers.cia402.host_watch import HostWatch
from drivers.eds import object_dictionary
from drivers.errors import CauseCode, CommunicationLost, ConnectionFailed, Measured
from drivers.ports import BusTraffic

logger = logging.getLogger(__name__)


class CanopenBus:
    """An open bus. `send` may be called from any thread."""

    def __init__(
        self,
        profile: BusProfile,
        nodes: tuple[int, ...],
        wires: frames.Wires = frames.VIRTUAL_WIRES,
        watch: HostWatch | None = None,
    ) -> None:
        """Opens the bus (blocking). `wires`: which PDOs to decode. `watch`: of the machine, if it outlives this bus.

        Raises ConnectionFailed if the bus cannot be opened.
        """
        self.watch = watch or HostWatch(profile.host_timeout)
        self._strangers = ForeignFrames(nodes, profile.host_node, wires)
        self._alone_from = float("inf")  # on the monotonic clock
        self._profile, self._wires = profile, wires
        self._interface = _open(profile)
        self._network = canopen.Network(self._interface)
        self._heard = dict.fromkeys(nodes, time.monotonic())
        self._restarted: set[int] = set()
        self._host_heard = False
        self._emergencies: dict[int, frames.Emergency] = {}
        self._controller: frames.Controller | None = None
        self._streams: dict[int, queue.SimpleQueue[frames.Event]] = {}
        self._lost: str | None = None
        self._received = self._sent = self._sent_bytes = self._received_bytes = 0  # frames and their data bytes
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._receive, name="can-receive", daemon=True)
        self._thread.start()

    @property
    def kernel_interface(self) -> str | None:
        """The network interface of a SocketCAN bus; None if python-can reaches the bus in another way."""
        return self._profile.channel if self._profile.interface == "socketcan" else None

    @property
    def traffic(self) -> BusTraffic:
        """Frames received and sent by this host; SDO requests of its client are not counted as sent.

        A data frame with 11-bit identifier has 47 bits beside its data, including interframe space (ISO 11898-1).
        """
        frames_, data = self._received + self._sent, self._received_bytes + self._sent_bytes
        return BusTraffic(self._received, self._sent, 47 * frames_ + 8 * data, self._profile.bitrate)

    def add_node(self, node: int, eds: str | None) -> SdoClient:
        """The SDO client of a node. Without the dictionary of `eds`, values have the length received."""
        objects = None if eds is None else object_dictionary(Path(eds), node)
        remote = RemoteNode(node, cast(Any, objects))
        self._network.add_node(remote)
        client: SdoClient = remote.sdo
        client.RESPONSE_TIMEOUT = self._profile.sdo_timeout
        self._heard[node] = time.monotonic()  # reading the dictionary took time
        return client

    def send(self, identifier: int, data: bytes) -> None:
        """Raises CommunicationLost if the interface refuses the frame or is already lost."""
        if self._lost is not None:
            raise CommunicationLost(self._lost)
        try:
            self._network.send_message(identifier, data)
            self._sent += 1
            self._sent_bytes += len(data)
        except (can.CanError, OSError) as error:
            reason = f"sending failed: {_in_a_line(error)}"
            self._fail(reason)
            raise CommunicationLost(f"bus {self._profile.channel}: {reason}") from None

    def shout(self, identifier: int, data: bytes) -> None:
        """As `send`, also on a bus that is lost because no node is heard: one that is silent may still receive."""
        try:
            self._network.send_message(identifier, data)
        except (can.CanError, OSError, RuntimeError) as error:  # RuntimeError: closed
            raise CommunicationLost(f"bus {self._profile.channel}: sending failed: {_in_a_line(error)}") from None

    def silent(self, node: int) -> bool:
        """Whether the bus is lost, or this node was silent for longer than the time-out."""
        return self._lost is not None or self._silence(self._heard[node]) > self._profile.drive_timeout

    def host_heard(self) -> bool:
        """Whether a heartbeat under our node id came since the last call; another host's if we send none."""
        heard, self._host_heard = self._host_heard, False
        return heard

    def expect_nodes(self) -> None:
        """Restart the measurement of every node's silence now."""
        self._heard = dict.fromkeys(self._heard, time.monotonic())

    def expect_no_host(self) -> None:
        """From now on a frame that only a host sends to our nodes is from another host; `watch` then forbids motion."""
        self._alone_from = time.monotonic()

    def kernel_sends(self, *, sending: bool) -> None:
        """While the kernel sends for this host, its frames are received like those of another host."""
        self._alone_from = float("inf") if sending else time.monotonic() + 1.0  # s in which its last frames may arrive

    def check_alive(self) -> None:
        """Raises CommunicationLost if the bus is lost or no node was heard for longer than the time-out."""
        timeout = self._profile.drive_timeout
        if self._lost is None and self._silence(max(self._heard.values())) > timeout:
            # A socketcand connection closed by the server never returns a frame: end the receiving thread.
            self._fail(f"no node was heard for {timeout} s")
        if self._lost is not None:
            raise CommunicationLost(self._lost)

    def check(self, node: int, joint: str = "") -> None:
        """Raises CommunicationLost if the bus is lost or this node was silent for longer than the time-out."""
        self.check_alive()
        silent = self._silence(self._heard[node])
        if silent > self._profile.drive_timeout:
            limit = self._profile.drive_timeout
            raise CommunicationLost(
                f"node {node}: no heartbeat for {silent:.2f} s", joint=joint, measured=Measured(silent, limit, "s")
            )

    def emergency(self, node: int) -> frames.Emergency | None:
        """The last error that the node announced and has not cleared."""
        return self._emergencies.get(node)

    def forget_emergency(self, node: int) -> None:
        self._emergencies.pop(node, None)

    def note_configured(self, node: int) -> None:
        """The node is now configured; `restarted` counts from here."""
        self._restarted.discard(node)

    def restarted(self, node: int) -> bool:
        """Whether the node sent its boot-up message after `note_configured`: its configuration is lost."""
        return node in self._restarted

    def open_stream(self, *nodes: int) -> queue.SimpleQueue[frames.Event]:
        """All events of these nodes and of the bus, in one order, from now until `close_stream`."""
        stream: queue.SimpleQueue[frames.Event] = queue.SimpleQueue()
        self._streams |= dict.fromkeys(nodes, stream)
        return stream

    def close_stream(self, *nodes: int) -> None:
        for node in nodes:
            self._streams.pop(node, None)

    def close(self) -> None:
        """Ends the thread and closes the interface. May be called twice."""
        self._closing.set()
        self._thread.join()
        if self._lost is None:
            self._lost = f"bus {self._profile.channel}: closed"
        self._network.disconnect()  # also shuts the interface down

    def _silence(self, heard: float) -> float:
        """s since the last reception. Time in which this host was suspended does not count."""
        return time.monotonic() - max(heard, self.watch.woke)

    def _fail(self, reason: str) -> None:
        if self._lost is None:
            counters = f"; controller {self._controller}" if self._controller else ""
            self._lost = f"bus {self._profile.channel}: {reason}{counters}"
            logger.error("%s", self._lost)
            self._tell_all(frames.Lost(self._lost))
        self._closing.set()

    def _tell_all(self, event: frames.Event) -> None:
        for stream in {id(stream): stream for stream in tuple(self._streams.values())}.values():
            stream.put(event)

    def _receive(self) -> None:
        try:
            while not self._closing.is_set():
                message = self._interface.recv(0.05)  # s; how long closing waits for this thread
                if message is not None and not message.is_remote_frame:
                    self._received += 1
                    self._received_bytes += len(message.data)
                    self._sort(message)
        except (can.CanError, OSError) as error:
            self._fail(f"receiving failed: {_in_a_line(error)}")
        except BaseException as error:  # a bus without a receiver must be marked as lost
            self._fail(f"receiving failed: {error!r}")
            raise

    def _sort(self, message: can.Message) -> None:
        if message.is_extended_id and not message.is_error_frame:
            return  # 29-bit identifier: not sent by one of our nodes, whatever its lower bits are
        identifier, data = message.arbitration_id, bytes(message.data)
        if not message.is_error_frame and time.monotonic() > self._alone_from:
            word = self._strangers.word(identifier, data)
            if word:
                self.watch.seen(word)
        if not message.is_error_frame and identifier & ~0x7F == frames.Cob.SDO_RESPONSE:
            node = identifier & 0x7F
            if node in self._heard and len(data) == 8:  # canopen's client fails on any other length
                self._heard[node] = time.monotonic()
                self._network.notify(identifier, bytearray(data), message.timestamp)
            return
        if identifier == frames.Cob.SYNC and not message.is_error_frame:
            # The kernel's time stamps use the wall clock; only the age of the frame is computed from them.
            self._tell_all(frames.Sync(time.monotonic() - max(0.0, time.time() - message.timestamp)))
            return
        event = frames.decode(identifier, data, message.is_error_frame, self._wires)
        if event is None:
            return
        if isinstance(event, frames.Controller):
            self._note_controller(event)
            return
        if isinstance(event, frames.SetPoint):  # sent by a host, not by the node
            if event.node in self._streams:
                self._streams[event.node].put(event)
            return
        if event.node not in self._heard:
            self._host_heard |= event.node == self._profile.host_node and isinstance(event, frames.Heartbeat)
            return
        self._heard[event.node] = time.monotonic()
        if isinstance(event, frames.Emergency):
            if event.code:
                self._emergencies[event.node] = event
            else:
                self._emergencies.pop(event.node, None)
        if isinstance(event, frames.Heartbeat) and event.state == frames.NmtState.BOOT_UP:
            self._restarted.add(event.node)
            logger.warning("bus %s: node %d restarted", self._profile.channel, event.node)
        stream = self._streams.get(event.node)
        if stream is not None:
            stream.put(event)

    def _note_controller(self, event: frames.Controller) -> None:
        """Logged once per change. A controller that was bus-off has lost frames, even if it restarted by itself."""
        known, self._controller = self._controller, event
        if known is None or event.state is not known.state:
            logger.warning("bus %s: controller is %s", self._profile.channel, event)
        if event.state in (frames.ControllerState.BUS_OFF, frames.ControllerState.RESTARTED):
            self._fail(event.state.value)


def _open(profile: BusProfile) -> can.BusABC:
    place = f"bus {profile.interface} {profile.channel}"
    options: dict[str, object] = {"interface": profile.interface, "channel": profile.channel}
    if profile.bitrate is not None:
        options["bitrate"] = profile.bitrate
    try:
        if profile.interface == "socketcand":
            # python-can retries a refused connection for 10 s in a busy loop; ask first.
            socket.create_connection((profile.host, profile.port), timeout=3.0).close()
            return SocketcandBus(profile.channel, profile.host, profile.port, tcp_tune=True)
        interface = can.Bus(**options)  # pyright: ignore[reportArgumentType]
        if isinstance(interface, SocketcanBus):
            # requested, so that a busy moment loses no frame (the kernel may limit it)
            interface.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        return interface
    except (can.CanError, OSError, ValueError) as error:
        where = f" at {profile.host}:{profile.port}" if profile.host else ""
        raise ConnectionFailed(f"{place}{where} could not be opened: {_in_a_line(error)}") from None


def _in_a_line(error: Exception) -> str:
    """For an operator: python-can's socketcand client puts its whole traceback into the message."""
    return " ".join(str(error).partition("Traceback")[0].split())


class ForeignFrames:
    """Detects another host on the bus by frames that only a host sends to these drives and that are not ours. Pure.

    Our own frames are not seen here: python-can and socketcand gateways do not return them. A stop is not reported,
    whoever sends it, especially the stop process, which sends nothing else (`frames.stop`): quick stop by RPDO, the
    SYNC after it, NMT stop, and SDO requests that read, by which it confirms the stop (`stop_sender`).
    """

    readings = 128  # SDO uploads after a stop that belong to it
    _what: ClassVar[dict[int, str]] = {frames.Cob.SDO_REQUEST: "SDO request"} | {
        frames.rpdo_id(number): f"RPDO{number}" for number in range(1, 5)
    }

    def __init__(self, nodes: Iterable[int], host_node: int, wires: frames.Wires = frames.VIRTUAL_WIRES) -> None:
        """`nodes`: our drives; `host_node`: node id of this host; `wires`: the RPDO that stops the drives."""
        self._nodes, self._host_node = frozenset(nodes), host_node
        self._quick_stops = frozenset(wires.stop_frame(node) for node in self._nodes)
        self._stopping = False  # a quick stop was received and its SYNC was not
        self._readings = 0  # remaining ones of the last stop

    def word(self, identifier: int, data: bytes) -> str:
        """Description of a frame of another host; "" if it does not address our drives, or is a stop. To be called with
        every data frame with an 11-bit identifier, in the order of the bus.
        """
        said = self._said(identifier, data)
        return f"another host is on the bus: {said} (COB-ID {identifier:03X}h)" if said else ""

    def _said(self, identifier: int, data: bytes) -> str:
        if identifier == frames.Cob.SYNC:
            stopping, self._stopping = self._stopping, False
            return "" if stopping else "SYNC"
        if identifier == frames.Cob.NMT:
            if len(data) < 2 or data[0] == frames.NmtCommand.STOP or (data[1] and data[1] not in self._nodes):
                return ""
            return f"NMT command {data[0]:02X}h to {f'node {data[1]}' if data[1] else 'every node'}"
        function, node = identifier & ~0x7F, identifier & 0x7F
        if function == frames.Cob.HEARTBEAT and node == self._host_node:
            return f"heartbeat with node number {node}, which this host uses"
        what = self._what.get(function)
        if node not in self._nodes or what is None:
            return ""
        if (identifier, bytes(data)) in self._quick_stops:
            self._stopping, self._readings = True, self.readings
            return ""
        if function == frames.Cob.SDO_REQUEST and data[:1] == bytes([frames.UPLOAD]) and self._readings:
            self._readings -= 1
            return ""
        return f"{what} to node {node}"


class SocketcandBus(SocketCanDaemonBus):
    """python-can's socketcand client, for a bus on which other nodes already send.

    python-can 4.6 reads each answer of its handshake together with the bytes after it, and so refuses a gateway whose
    first frames arrive in the same packet as the last "< ok >". Here exactly the answer is read. Raises CanError, and
    leaves nothing open, if the gateway gives another answer or is too late.
    """

    answer_timeout = 10.0  # s, for each answer of the handshake

    def _expect_msg(self, msg: str) -> None:
        connection = cast(socket.socket, cast(Any, self)._SocketCanDaemonBus__socket)
        connection.settimeout(self.answer_timeout)
        try:
            answer = _exactly(connection, len(msg)).decode("ascii", "replace")
        except OSError as error:
            connection.close()
            raise can.CanError(f"the gateway did not send '{msg}': {error}") from None
        if answer != msg:
            connection.close()
            raise can.CanError(f"Expected '{msg}' got: '{answer}'")
        connection.settimeout(None)


def _exactly(connection: socket.socket, length: int) -> bytes:
    """Read `length` bytes, or fewer if the gateway closes."""
    received = b""
    while len(received) < length and (more := connection.recv(length - len(received))):
        received += more
    return received


Cycle = Sequence[tuple[int, bytes]]


class Bcm(IntFlag):
    """Operations and flags of the broadcast manager."""

    TX_SETUP = 1
    TX_DELETE = 2
    SETTIMER = 1
    STARTTIMER = 2


def set_point_source(bus: CanopenBus, *, waits: bool = False) -> str:
    """What times the set-points of streamed sweeps on this bus: "bcm" (the kernel) or "thread".

    `waits`: the host delays SYNC until all drives have answered. Only its own thread can do that.
    """
    if waits or bus.kernel_interface is None:
        return "thread"
    try:
        _connect(bus.kernel_interface).close()
    except OSError:
        return "thread"
    return "bcm"


def _connect(interface: str) -> socket.socket:
    if not hasattr(socket, "CAN_BCM"):
        raise OSError("this computer has no CAN_BCM sockets")
    connected = socket.socket(socket.AF_CAN, socket.SOCK_DGRAM, socket.CAN_BCM)
    try:
        connected.connect((interface,))
        connected.setblocking(False)
    except OSError:
        connected.close()
        raise
    return connected


class KernelRefused(CommunicationLost, code=CauseCode.COMMUNICATION_LOST):
    """The kernel does not accept (further) set-points: interface down or removed, no memory."""


class KernelStream:
    """The cycles of a sweep, sent by the kernel. Every method raises KernelRefused if the kernel refuses them."""

    def __init__(self, interface: str, period: float, plan: Callable[[int], Cycle], rest: Cycle) -> None:
        """`plan(k)`: set-points and SYNC of cycle k; `rest` is sent if there is no refill. `period` in s."""
        size = len(rest)
        self._plan, self._rest = plan, _pack(rest)
        self._cycles = min(256 // size, round(1.0 / period))  # frames of a job at most; 1 s
        self._spare = max(2, self._cycles // 4)  # cycles of `rest` after the planned ones
        self._step = max(1, self._cycles // 8)  # cycles between refills
        self._identifier = rest[0][0]
        self._size = size
        self._steering = Steering(period / size, self._step * size)
        self._ring = [self._rest] * self._cycles
        self._filled = 0  # cycles planned so far
        self._next_top_up = self._step
        try:
            self._socket = _connect(interface)
        except OSError as error:
            raise KernelRefused(f"{interface}: the kernel's CAN_BCM timer is not available: {error}") from None
        self._interface = interface

    def begin(self) -> None:
        """Send cycle 0 now."""
        self._fill(0)
        self._set_up(Bcm.SETTIMER | Bcm.STARTTIMER)

    def note(self, late: float) -> None:
        """A cycle was sent `late` s after its deadline."""
        self._steering.note(late)

    def top_up(self, sent: int) -> None:
        """Plans further cycles if it is time. `sent` cycles were sent, and no event about further ones is waiting."""
        if sent >= self._next_top_up:
            self._next_top_up = sent + self._step
            self._fill(sent)
            self._steering.adjust()
            self._set_up(Bcm.SETTIMER)

    def close(self) -> None:
        """Nothing is sent after this."""
        with suppress(OSError):  # the interface and its job may be gone
            self._socket.send(_head(Bcm.TX_DELETE, 0, 0, 0.0, self._identifier, 0))
        self._socket.close()

    def _fill(self, sent: int) -> None:
        end = sent + self._cycles - self._spare
        for number in range(self._filled, end):
            self._ring[number % self._cycles] = _pack(self._plan(number))
        for number in range(end, end + self._spare):
            self._ring[number % self._cycles] = self._rest
        self._filled = end

    def _set_up(self, flags: int) -> None:
        # A cycle may be in progress or sent but not yet seen: the count ends half-way through the spare ones.
        count = (self._cycles - self._spare + self._spare // 2) * self._size
        interval = self._steering.interval
        head = _head(Bcm.TX_SETUP, flags, count, interval, self._identifier, self._cycles * self._size)
        try:
            self._socket.send(head + b"".join(self._ring))
        except OSError as error:
            raise KernelRefused(f"{self._interface}: the kernel refused the set-points: {error}") from None


class Steering:
    """PI control of the interval between two frames, so that the cycles keep to their deadlines. Pure."""

    def __init__(self, interval: float, frames_between: int) -> None:
        """Nominal interval, s, and number of frames between two adjustments."""
        self.interval = interval
        self._nominal, self._frames = interval, frames_between
        self._sum, self._count = 0.0, 0
        self._delay = 0.0  # delay of the kernel in each interval, s

    def note(self, late: float) -> None:
        """A cycle was `late` s after its deadline."""
        self._sum += late
        self._count += 1

    def adjust(self) -> None:
        """Compute a new interval from the lateness noted since the last adjustment."""
        late = self._sum / max(1, self._count)
        self._sum, self._count = 0.0, 0
        correction = 0.5 * late / self._frames
        self._delay += 0.2 * late / self._frames
        most = 0.1 * self._nominal  # a kernel that needs more is late, which is counted
        self._delay = max(-most, min(most, self._delay))
        self.interval = self._nominal - max(-most, min(most, self._delay + correction))


def _head(opcode: int, flags: int, count: int, interval: float, identifier: int, size: int) -> bytes:
    microseconds = max(1, round(interval * 1e6))
    # opcode, flags, count, ival1 s us, ival2 s us, can_id, nframes
    return struct.pack("@3I4l2I0q", opcode, flags, count, 0, microseconds, 0, 0, identifier, size)


def _pack(cycle: Cycle) -> bytes:
    return b"".join(struct.pack("=IB3x8s", identifier, len(data), data) for identifier, data in cycle)
