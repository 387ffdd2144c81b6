"""The stop of CANopen drives from a separate process: a second socketcand client or SocketCAN socket, without a
library.

It sends no heartbeat and no request, so that neither the drives nor the service detect it as a host.
"""

import re
import select
import socket
import struct
import threading
import time
from collections.abc import Mapping
from contextlib import suppress

from drivers.canopen import frames
from drivers.canopen.profile import BusProfile, CanopenProfile
from drivers.errors import CommunicationLost, ConnectionFailed, NotReady

OPEN_TIMEOUT = 1.0  # s, of one step of opening
_SOCKETCAND_FRAME = re.compile(rb"< (frame|error) ([0-9A-Fa-f]+) [^<>]*>")
_CAN_FRAME = struct.Struct("=IB3x8s")  # linux/can.h
_CAN_RAW_ERR_FILTER = 2  # linux/can/raw.h; the socket module lacks this constant
_ERROR_FLAG, _ERROR_MASK = 0x20000000, 0x1FFFFFFF


class CanopenStopSender:
    """See `drivers.ports.StopSender`."""

    def __init__(self, profile: CanopenProfile) -> None:
        """Raises NotReady if only one process can open the interface."""
        bus = profile.bus
        if bus.interface not in ("socketcand", "socketcan"):
            raise NotReady(f"bus {bus.interface} {bus.channel}: only one process can open it, and the service has it")
        self._bus = bus
        self._wires = profile.device_map.wires
        self._joints = {axis.node: axis.joint for axis in profile.axes}
        self._heard: dict[int, float] = {}
        self._off = False  # bus-off was reported and no node was heard since
        self._rest = b""  # of an incomplete line
        self._socket: socket.socket | None = None
        self._sending = threading.Lock()

    def open(self) -> None:
        self.close()
        place = f"bus {self._bus.interface} {self._bus.channel}"
        try:
            self._socket = _socketcand(self._bus) if self._bus.interface == "socketcand" else _socketcan(self._bus)
        except OSError as error:
            raise ConnectionFailed(f"{place} could not be opened for the stop: {error}") from None
        self._rest, self._off = b"", False
        self._heard.clear()

    def listen(self, within: float) -> None:
        bus = self._open()
        try:
            if select.select([bus], [], [], within)[0]:
                data = bus.recv(65536)
                if not data:
                    raise OSError("closed by the gateway")
                self._take(data)
        except (OSError, ValueError) as error:  # ValueError: closed by another thread
            raise CommunicationLost(f"bus {self._bus.channel}: {error}") from None

    def send(self) -> Mapping[str, str]:
        self._send(deaf=False)
        return {joint: self._doubt(node) for node, joint in self._joints.items()}

    def insist(self) -> None:
        """As `send`, with NMT stop: the drives then accept neither process data nor SDO."""
        self._send(deaf=True)

    def close(self) -> None:
        bus, self._socket = self._socket, None
        if bus is not None:
            bus.close()

    # -- inside --------------------------------------------------------------------------------------------------

    def _open(self) -> socket.socket:
        if self._socket is None:
            raise CommunicationLost(f"bus {self._bus.channel}: not open")
        return self._socket

    def _send(self, *, deaf: bool) -> None:
        deaf_ones = self._joints if deaf else ()
        packed = [self._packed(*frame) for frame in frames.stop(self._joints, deaf_ones, wires=self._wires)]
        with self._sending:
            bus = self._open()
            try:
                for each in packed:
                    bus.sendall(each)
            except OSError as error:
                raise CommunicationLost(f"bus {self._bus.channel}: sending failed: {error}") from None

    def _packed(self, identifier: int, data: bytes) -> bytes:
        if self._bus.interface == "socketcan":
            return _CAN_FRAME.pack(identifier, len(data), data)
        words = " ".join(f"{byte:x}" for byte in data)
        return f"< send {identifier:03x} {len(data):x} {words} >".encode("ascii")

    def _doubt(self, node: int) -> str:
        if self._off:
            return "the bus is off"
        silent = time.monotonic() - self._heard.get(node, float("-inf"))
        return "" if silent <= self._bus.drive_timeout else "is not heard on the bus"

    def _take(self, data: bytes) -> None:
        if self._bus.interface == "socketcan":
            (word,) = struct.unpack_from("=I", data)
            self._note(word & _ERROR_MASK, error=bool(word & _ERROR_FLAG))
            return
        data = self._rest + data
        for kind, identifier in _SOCKETCAND_FRAME.findall(data):
            if kind == b"error" or len(identifier) <= 3:  # no 29 bits
                self._note(int(identifier, 16), error=kind == b"error")
        self._rest = data[data.rfind(b"<") :][-256:] if data.rfind(b">") < data.rfind(b"<") else b""

    def _note(self, identifier: int, *, error: bool) -> None:
        if error:
            self._off = self._off or bool(identifier & frames.ERROR_BUS_OFF)
            return
        node = identifier & 0x7F
        if (
            identifier & ~0x7F in (frames.HEARTBEAT, frames.tpdo_id(self._wires.state), frames.SDO_RESPONSE)
            and node in self._joints
        ):
            self._heard[node] = time.monotonic()
            self._off = False


def _socketcand(profile: BusProfile) -> socket.socket:
    """A client in raw mode. Raises OSError."""
    client = socket.create_connection((profile.host or "", profile.port or 0), OPEN_TIMEOUT)
    try:
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for said, answer in (("", "< hi >"), (f"< open {profile.channel} >", "< ok >"), ("< rawmode >", "< ok >")):
            client.sendall(said.encode())
            got = b""
            while b">" not in got:
                more = client.recv(4096)
                if not more:
                    raise OSError("closed by the gateway")
                got += more
            if not got.startswith(answer.encode()):
                raise OSError(f"the gateway answered {got[:80]!r}")
    except BaseException:
        client.close()
        raise
    return client


def _socketcan(profile: BusProfile) -> socket.socket:
    """A raw socket that receives heartbeats and error frames of the controller. Raises OSError."""
    if not hasattr(socket, "AF_CAN"):
        raise OSError("this computer has no SocketCAN")
    bus = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    try:
        heartbeats = struct.pack("=II", frames.HEARTBEAT, 0x780)
        bus.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, heartbeats)
        bus.setsockopt(socket.SOL_CAN_RAW, _CAN_RAW_ERR_FILTER, frames.ERROR_BUS_OFF)
        bus.settimeout(OPEN_TIMEOUT)
        bus.bind((profile.channel,))
    except BaseException:
        with suppress(OSError):
            bus.close()
        raise
    return bus
