"""The stop of CANopen drives from a separate process: a second socketcand client or SocketCAN socket, without a
library.

It sends no heartbeat, so that neither the drives nor the service detect it as a host. `HeardState` is how it hears that
an axis stands.
"""

import re
import select
import socket
import struct
import threading
import time
from collections.abc import Iterable, Mapping
from contextlib import suppress

from drivers.canopen import frames
from drivers.canopen.profile import BusProfile, CanopenAxis, CanopenProfile, DeviceMap, Entry, codec
from drivers.cia402 import states
from drivers.errors import CommunicationLost, ConnectionFailed, DriveError, NotReady


def upload_request(entry: Entry) -> bytes:
    """SDO request that reads an object."""
    return struct.pack("<BHB4x", frames.UPLOAD, entry.index, entry.sub)


class HeardState:
    """What one node reports of its state on a bus that another host uses: statusword and velocity. Pure.

    Sources, none of which disturbs the other host: TPDO `state`, and the answers to SDO uploads that the other host
    requests. A block or segmented transfer has data that look like answers; so an answer counts only after its request.
    Times are s on the monotonic clock.
    """

    def __init__(self, axis: CanopenAxis, device_map: DeviceMap) -> None:
        self._axis, self._map = axis, device_map
        self.asked_by_service = float("-inf")  # time of its last SDO request to this node
        self._nmt: int | None = None
        self._requested: tuple[int, int] | None = None  # index and sub-index
        self._asked = float("-inf")
        self._at = float("-inf")  # time of the last request or question that is not answered yet
        self._values: dict[tuple[int, int], tuple[bytes, float]] = {}  # by object: value, time of its request
        self._pdo: tuple[frames.MotionPdo, float] | None = None

    @property
    def pre_operational(self) -> bool:
        """Whether the node reports that it accepts no process data, and answers SDO."""
        return self._nmt == frames.NmtState.PRE_OPERATIONAL

    def note(self, event: frames.Event, now: float) -> None:
        """A frame of this node other than SDO."""
        if isinstance(event, frames.MotionPdo):
            self._pdo = event, now
        elif isinstance(event, frames.Heartbeat):
            self._nmt = event.state

    def requested(self, data: bytes, now: float) -> None:
        """An SDO request of the other host."""
        self.asked_by_service = now
        self._expect(data, now)

    def answered(self, data: bytes, now: float) -> None:
        """An SDO response of the node."""
        if len(data) != 8 or self._requested is None:
            return
        specifier, index, sub = struct.unpack_from("<BHB", data)
        if (index, sub) != self._requested:
            return
        self._requested = None
        size = {0x43: 4, 0x47: 3, 0x4B: 2, 0x4F: 1, 0x42: 4}.get(specifier)  # of an expedited answer, bytes
        if size:
            self._values[index, sub] = data[4 : 4 + size], self._at

    def question(self, since: float, now: float) -> bytes:
        """The next SDO upload request that is needed to know the state after `since`; b"" if an answer is awaited."""
        if self._requested is not None and now - self._asked < 0.1:  # s, then it is asked again
            return b""
        status, velocity = (self._value(name, since) for name in ("statusword", "velocity"))
        if status is None or (velocity is not None and velocity[1] >= status[1]):
            name = next((name for name in self._unknown_units()), "statusword")
        else:
            name = "velocity"
        self._asked = now
        request = upload_request(self._map.entry(name))
        self._expect(request, now)
        return request

    def doubt(self, since: float) -> str:
        """Why it is not known that the axis stood without energy at a time after `since`; "" if it reported that."""
        reported = self._reported(since)
        if reported is None:
            return "its state cannot be heard here" if self._nmt is None else "does not report its state"
        status, velocity = reported
        if states.decode(status) not in states.WITHOUT_ENERGY:
            return f"is '{states.decode(status).value}'"
        limit = self._limit()
        return "" if abs(velocity) <= limit else f"turns at {velocity} velocity units, standstill is at most {limit:g}"

    # -- inside --------------------------------------------------------------------------------------------------

    def _reported(self, since: float) -> tuple[int, int] | None:
        """Statusword and raw velocity of the same time or of a later velocity; the newest after `since`."""
        found: list[tuple[float, int, int]] = []
        if self._pdo is not None and self._pdo[1] > since:
            found.append((self._pdo[1], self._pdo[0].statusword, self._pdo[0].velocity))
        status, velocity = self._value("statusword", since), self._value("velocity", since)
        if status is not None and velocity is not None and velocity[1] >= status[1]:
            found.append((status[1], int(status[0]), int(velocity[0])))
        elif status is not None and states.decode(int(status[0])) not in states.WITHOUT_ENERGY:
            found.append((status[1], int(status[0]), 0))  # it is energised, whatever its velocity is
        return max(found)[1:] if found else None

    def _value(self, name: str, since: float) -> tuple[float, float] | None:
        """The value of an object that was requested after `since`, and the time of the request."""
        entry = self._map.entry(name)
        value, at = self._values.get((entry.index, entry.sub), (b"", float("-inf")))
        if at <= since:
            return None
        with suppress(struct.error):
            return entry.unpack(value), at
        return None

    def _expect(self, data: bytes, now: float) -> None:
        self._requested = None
        if len(data) == 8 and data[0] == frames.UPLOAD:
            _, index, sub = struct.unpack("<BHB4x", data)
            self._requested, self._at = (index, sub), now

    def _unknown_units(self) -> list[str]:
        units = self._map.units
        wanted = ("velocity_unit", "increments", "motor_revolutions") if units.velocity == "60A9h" else ()
        return [
            name
            for name in wanted
            if name not in self._map.missing
            and self._value(name, float("-inf")) is None
            and not (name != "velocity_unit" and units.increments != "608Fh")
        ]

    def _limit(self) -> float:
        """Largest raw velocity at standstill. 0 while the unit of the drive was not heard: 0 is 0 in every unit."""

        def read(name: str) -> float:
            if name in self._map.missing:
                return 1.0
            value = self._value(name, float("-inf"))
            if value is None:
                raise KeyError(name)
            return value[0]

        units = self._map.units.model_copy(update={"effort": "torque"})  # its unit is not needed
        try:
            return abs(self._axis.standstill_velocity / float(codec(self._axis, units, 1.0, read).velocity(1.0)))
        except (KeyError, DriveError, ZeroDivisionError):
            return 0.0


SEND_TIMEOUT = 0.2  # s; a gateway that takes no more frames is lost


class CanopenStopSender:
    """See `drivers.ports.StopSender`."""

    can_frame = struct.Struct("=IB3x8s")  # linux/can.h
    poll = 0.005  # s

    def __init__(self, profile: CanopenProfile) -> None:
        """Raises NotReady if only one process can open the interface."""
        bus = profile.bus
        if bus.interface not in ("socketcand", "socketcan"):
            raise NotReady(f"bus {bus.interface} {bus.channel}: only one process can open it, and the service has it")
        self._bus = bus
        self._wires = profile.device_map.wires
        self._joints = {axis.node: axis.joint for axis in profile.axes}
        self._states = {axis.node: HeardState(axis, profile.device_map) for axis in profile.axes}
        self._heard: dict[int, float] = {}
        self._sent = float("inf")  # on the monotonic clock: time of the last stop
        self._alone = False  # no service has taken the last stop over
        self._confirming = 0  # number of threads in `confirm`
        self._receiving = threading.Lock()
        self._off = False  # bus-off was reported and no node was heard since
        self._rest = b""  # of an incomplete line
        self._socket: socket.socket | None = None
        self._sending = threading.Lock()

    def open(self) -> None:
        self.close()
        place = f"bus {self._bus.interface} {self._bus.channel}"
        try:
            socketcand = self._bus.interface == "socketcand"
            self._socket = _socketcand(self._bus) if socketcand else _socketcan(self._bus, self._wires)
        except OSError as error:
            raise ConnectionFailed(f"{place} could not be opened for the stop: {error}") from None
        self._rest, self._off = b"", False
        self._heard.clear()

    def listen(self, within: float) -> None:
        with self._receiving:
            self._receive(within)

    def send(self) -> Mapping[str, str]:
        self._alone, now = False, time.monotonic()
        self._send()
        self._sent = now
        return {joint: self._doubt(node) for node, joint in self._joints.items()}

    def confirm(self, within: float) -> Mapping[str, str]:
        """Nodes in NMT operational report their state at the SYNC of the stop, which is repeated. The others are heard
        when they answer the stop sequence of the service; a node that the service does not ask is asked from here.
        """
        every = 0.05  # s
        deadline, since = time.monotonic() + within, self._sent
        again = time.monotonic() + every
        self._confirming += 1
        try:
            while any((doubts := self._unconfirmed(since)).values()) and (now := time.monotonic()) < deadline:
                if now >= again:
                    again = now + every
                    self._send()
                self._ask(since)
                if self._receiving.acquire(timeout=CanopenStopSender.poll):  # otherwise `listen` receives
                    try:
                        self._receive(CanopenStopSender.poll)
                    finally:
                        self._receiving.release()
        except CommunicationLost as error:
            return dict.fromkeys(self._joints.values(), str(error))
        finally:
            self._confirming -= 1
        return doubts

    def insist(self) -> None:
        """As `send`, with NMT stop: the drives then accept neither process data nor SDO. Nodes that accept no process
        data already get it only after they had time to answer `confirm`.
        """
        self._alone = True
        listening = [node for node, state in self._states.items() if state.pre_operational]
        self._send(deaf=[node for node in self._joints if node not in listening])
        until = time.monotonic() + 0.05  # s for the answers of nodes that are asked before they are made deaf
        while self._confirming and time.monotonic() < until:
            if not any(self._states[node].doubt(self._sent) for node in listening):
                break
            time.sleep(CanopenStopSender.poll)
        self._send(deaf=self._joints)

    def close(self) -> None:
        bus, self._socket = self._socket, None
        if bus is not None:
            bus.close()

    # -- inside --------------------------------------------------------------------------------------------------

    def _open(self) -> socket.socket:
        if self._socket is None:
            raise CommunicationLost(f"bus {self._bus.channel}: not open")
        return self._socket

    def _receive(self, within: float) -> None:
        bus = self._open()
        try:
            if select.select([bus], [], [], within)[0]:
                data = bus.recv(65536)
                if not data:
                    raise OSError("closed by the gateway")
                self._take(data)
        except (OSError, ValueError) as error:  # ValueError: closed by another thread
            raise CommunicationLost(f"bus {self._bus.channel}: {error}") from None

    def _unconfirmed(self, since: float) -> dict[str, str]:
        return {joint: self._doubt(node) or self._states[node].doubt(since) for node, joint in self._joints.items()}

    def _ask(self, since: float) -> None:
        """Ask nodes that the service has not asked for 0.3 s."""
        now = time.monotonic()
        for node, state in self._states.items():
            quiet = now - max(state.asked_by_service, since)
            if (self._alone or quiet > 0.3) and state.doubt(since) and (request := state.question(since, now)):
                self._transmit([(frames.Cob.SDO_REQUEST + node, request)])

    def _send(self, *, deaf: Iterable[int] = ()) -> None:
        self._transmit(frames.stop(self._joints, deaf, wires=self._wires))

    def _transmit(self, wanted: Iterable[tuple[int, bytes]]) -> None:
        packed = b"".join(self._packed(*frame) for frame in wanted)
        size = CanopenStopSender.can_frame.size if self._bus.interface == "socketcan" else len(packed)
        with self._sending:
            bus = self._open()
            try:
                for start in range(0, len(packed), size):
                    bus.sendall(packed[start : start + size])
            except OSError as error:
                raise CommunicationLost(f"bus {self._bus.channel}: sending failed: {error}") from None

    def _packed(self, identifier: int, data: bytes) -> bytes:
        if self._bus.interface == "socketcan":
            return CanopenStopSender.can_frame.pack(identifier, len(data), data)
        words = " ".join(f"{byte:x}" for byte in data)
        return f"< send {identifier:03x} {len(data):x} {words} >".encode("ascii")

    def _doubt(self, node: int) -> str:
        if self._off:
            return "the bus is off"
        silent = time.monotonic() - self._heard.get(node, float("-inf"))
        return "" if silent <= self._bus.drive_timeout else "is not heard on the bus"

    def _take(self, data: bytes) -> None:
        if self._bus.interface == "socketcan":
            word, length, content = CanopenStopSender.can_frame.unpack(data[: CanopenStopSender.can_frame.size])
            self._note(word & 0x1FFFFFFF, content[:length], error=bool(word & 0x20000000))  # CAN_ERR_MASK, CAN_ERR_FLAG
            return
        data = self._rest + data
        for kind, identifier, content in re.findall(
            rb"< (frame|error) ([0-9A-Fa-f]+) [^ <>]+(?: ([0-9A-Fa-f ]*))?>", data
        ):
            if kind == b"error" or len(identifier) <= 3:  # no 29 bits
                with suppress(ValueError):  # an odd number of digits
                    self._note(int(identifier, 16), bytes.fromhex(content.decode()), error=kind == b"error")
        self._rest = data[data.rfind(b"<") :][-256:] if data.rfind(b">") < data.rfind(b"<") else b""

    def _note(self, identifier: int, data: bytes, *, error: bool) -> None:
        if error:
            self._off = self._off or bool(identifier & frames.ErrorClass.BUS_OFF)
            return
        now, function, node = time.monotonic(), identifier & ~0x7F, identifier & 0x7F
        state = self._states.get(node)
        if state is None:
            return
        if function == frames.Cob.SDO_REQUEST:  # of the service: we do not receive what we send
            state.requested(data, now)
            return
        if function == frames.Cob.SDO_RESPONSE:
            state.answered(data, now)
        elif (event := frames.decode(identifier, data, wires=self._wires)) is not None:
            state.note(event, now)
        if function in (frames.Cob.HEARTBEAT, frames.tpdo_id(self._wires.state), frames.Cob.SDO_RESPONSE):
            self._heard[node] = now
            self._off = False


def _socketcand(profile: BusProfile) -> socket.socket:
    """A client in raw mode. Raises OSError."""
    client = socket.create_connection((profile.host or "", profile.port or 0), 1.0)  # s, of each step
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
        client.settimeout(SEND_TIMEOUT)
    except BaseException:
        client.close()
        raise
    return client


def _socketcan(profile: BusProfile, wires: frames.Wires) -> socket.socket:
    """A raw socket that receives what nodes report, and error frames of the controller. Raises OSError."""
    if not hasattr(socket, "AF_CAN"):
        raise OSError("this computer has no SocketCAN")
    bus = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    try:
        heard = (frames.Cob.HEARTBEAT, frames.tpdo_id(wires.state), frames.Cob.SDO_REQUEST, frames.Cob.SDO_RESPONSE)
        filters = b"".join(struct.pack("=II", function, 0x780) for function in heard)
        bus.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, filters)
        bus.setsockopt(socket.SOL_CAN_RAW, 2, frames.ErrorClass.BUS_OFF)  # CAN_RAW_ERR_FILTER of linux/can/raw.h
        bus.settimeout(SEND_TIMEOUT)
        bus.bind((profile.channel,))
    except BaseException:
        with suppress(OSError):
            bus.close()
        raise
    return bus
