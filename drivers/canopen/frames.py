"""CAN frames -> typed events, pure. An unknown frame gives None; no content raises an error.

COB-IDs of CiA 301's predefined connection set; PDO contents as mapped in `configuration.py`.
"""

import struct
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum, IntEnum, IntFlag

from drivers.cia402.states import Controlword


class Cob(IntEnum):
    """COB-IDs; those of a node are given without it."""

    NMT = 0x000
    SYNC = 0x080
    EMERGENCY = 0x080
    TPDO1 = 0x180
    RPDO1 = 0x200
    TPDO2 = 0x280
    RPDO2 = 0x300
    RPDO3 = 0x400
    RPDO4 = 0x500
    SDO_RESPONSE = 0x580
    SDO_REQUEST = 0x600
    HEARTBEAT = 0x700


class NmtCommand(IntEnum):
    """Commands of network management."""

    START = 0x01
    STOP = 0x02
    PRE_OPERATIONAL = 0x80


class NmtState(IntEnum):
    """State byte of a heartbeat."""

    BOOT_UP = 0x00
    OPERATIONAL = 0x05
    PRE_OPERATIONAL = 0x7F


class ErrorClass(IntFlag):
    """SocketCAN's error classes, in the identifier of an error frame (linux/can/error.h)."""

    CONTROLLER = 0x004
    BUS_OFF = 0x040
    RESTARTED = 0x100


UPLOAD = 0x40
"""Command specifier of an SDO upload request."""


@dataclass(frozen=True, slots=True)
class Wires:
    """Numbers of the PDOs of a node (predefined connection set): see `device_map.Pdos`."""

    set_point: int = 1
    stop: int | None = None
    state: int = 1
    place: int = 2
    counted: bool = True  # TPDO2 has position and sample counter; False: position and velocity

    def set_point_id(self, node: int) -> int:
        return rpdo_id(self.set_point) + node

    def stop_frame(self, node: int) -> tuple[int, bytes]:
        """Quick stop for a node that needs no answer. It never contains a new target position."""
        if self.stop is None:
            return self.set_point_id(node), rpdo1(Controlword.QUICK_STOP, 0)
        return rpdo_id(self.stop) + node, struct.pack("<H", Controlword.QUICK_STOP)


def rpdo_id(number: int) -> int:
    """COB-ID of RPDO `number` without node."""
    return 0x100 + 0x100 * number


def tpdo_id(number: int) -> int:
    """COB-ID of TPDO `number` without node."""
    return 0x080 + 0x100 * number


@dataclass(frozen=True, slots=True)
class MotionPdo:
    """TPDO1: 6041h, 606Ch, 6077h (or 6078h) of one SYNC."""

    node: int
    statusword: int
    velocity: int
    torque: int


@dataclass(frozen=True, slots=True)
class PositionPdo:
    """TPDO2: 6064h and the sample counter 2120h:01 of one SYNC; without a counter (then 0) 606Ch instead."""

    node: int
    position: int
    counter: int
    velocity: int = 0


@dataclass(frozen=True, slots=True)
class Emergency:
    """EMCY; code 0 means that the error is cleared."""

    node: int
    code: int
    register: int
    maker: bytes


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """NMT state of a node."""

    node: int
    state: int


class ControllerState(Enum):
    """State of this host's CAN controller (ISO 11898-1 fault confinement)."""

    ACTIVE = "error active"
    WARNING = "error warning"
    PASSIVE = "error passive"
    BUS_OFF = "bus-off"
    RESTARTED = "restarted after bus-off"


@dataclass(frozen=True, slots=True)
class Controller:
    """An error frame: state of the controller and its error counters, 0 if they are not reported."""

    state: ControllerState
    transmit_errors: int
    receive_errors: int

    def __str__(self) -> str:
        return f"{self.state.value} (transmit errors {self.transmit_errors}, receive errors {self.receive_errors})"


@dataclass(frozen=True, slots=True)
class SetPoint:
    """Set-point or stop to a node, seen on the bus: sent by the kernel or by another host."""

    node: int
    data: bytes


Frame = MotionPdo | PositionPdo | Emergency | Heartbeat | Controller | SetPoint


@dataclass(frozen=True, slots=True)
class Sync:
    """SYNC seen on the bus, with its time on the monotonic clock, s."""

    at: float


@dataclass(frozen=True, slots=True)
class Lost:
    """The bus is lost: bus-off, interface down, gateway disconnected. The last event of a stream."""

    reason: str


Event = Frame | Sync | Lost

VIRTUAL_WIRES = Wires()


def decode(identifier: int, data: bytes, error: bool = False, wires: Wires = VIRTUAL_WIRES) -> Frame | None:
    """The event of a frame; None if the frame is not for us (SDO answers go to the SDO client). `Bus` handles SYNC."""
    if error:
        return _controller(identifier, data)
    function, node = identifier & ~0x7F, identifier & 0x7F
    if node == 0:
        return None
    if function == tpdo_id(wires.state) and len(data) == 8:
        return MotionPdo(node, *struct.unpack("<Hih", data))
    if function == tpdo_id(wires.place) and len(data) == 8:
        if wires.counted:
            return PositionPdo(node, *struct.unpack("<iI", data))
        position, velocity = struct.unpack("<ii", data)
        return PositionPdo(node, position, 0, velocity)
    if function in (rpdo_id(wires.set_point), rpdo_id(wires.stop or wires.set_point)):
        return SetPoint(node, data)
    if function == Cob.EMERGENCY and len(data) == 8:
        return Emergency(node, *struct.unpack("<HB5s", data))
    if function == Cob.HEARTBEAT and len(data) == 1:
        return Heartbeat(node, data[0] & 0x7F)
    return None


def _controller(classes: int, data: bytes) -> Controller | None:
    """linux/can/error.h: error classes in the identifier, details in eight data bytes."""
    detail, transmit, receive = (data[1], data[6], data[7]) if len(data) == 8 else (0, 0, 0)
    if classes & ErrorClass.BUS_OFF:
        state = ControllerState.BUS_OFF
    elif classes & ErrorClass.RESTARTED:
        state = ControllerState.RESTARTED
    elif classes & ErrorClass.CONTROLLER and detail & 0x30:
        state = ControllerState.PASSIVE
    elif classes & ErrorClass.CONTROLLER and detail & 0x0C:
        state = ControllerState.WARNING
    elif classes & ErrorClass.CONTROLLER and detail & 0x40:
        state = ControllerState.ACTIVE
    else:
        return None
    return Controller(state, transmit, receive)


def stop(
    nodes: Iterable[int], deaf: Iterable[int], *, sync: bool = True, wires: Wires = VIRTUAL_WIRES
) -> list[tuple[int, bytes]]:
    """Identifier and data of frames that stop these nodes without an answer: quick stop by RPDO, taken over by `sync`.

    `deaf`: nodes that also get NMT stop, to which they react as set in 6007h. They then answer no SDO until NMT
    pre-operational.
    """
    quick_stops = [wires.stop_frame(node) for node in nodes]
    return [
        *quick_stops,
        *([(Cob.SYNC, b"")] if sync else []),
        *((Cob.NMT, bytes([NmtCommand.STOP, node])) for node in deaf),
    ]


def rpdo1(controlword: int, target: int) -> bytes:
    """6040h and the target: 60FFh or a position."""
    return struct.pack("<Hi", controlword, target)
