"""CAN frames -> typed events, pure. What is not understood is None; no bytes can make it fail.

COB-IDs of CiA 301's predefined connection set; PDO contents as mapped in `configuration.py`.
"""

import struct
from dataclasses import dataclass

SYNC = 0x080
EMERGENCY = 0x080
TPDO1 = 0x180
RPDO1 = 0x200
TPDO2 = 0x280
SDO_RESPONSE = 0x580
HEARTBEAT = 0x700

NMT = 0x000
NMT_START, NMT_STOP, NMT_PRE_OPERATIONAL = 0x01, 0x02, 0x80
OPERATIONAL = 0x05  # heartbeat's state byte

ERROR_BUS_OFF = 0x40  # SocketCAN's error class in the identifier of an error frame

_TPDO1 = struct.Struct("<Hih")
_TPDO2 = struct.Struct("<iI")
_EMERGENCY = struct.Struct("<HB5s")
_RPDO1 = struct.Struct("<Hi")


@dataclass(frozen=True, slots=True)
class Motion:
    """TPDO1: 6041h, 606Ch, 6077h of one SYNC."""

    node: int
    statusword: int
    velocity: int
    torque: int


@dataclass(frozen=True, slots=True)
class Place:
    """TPDO2: 6064h and the sample counter 2120h:01 of one SYNC."""

    node: int
    position: int
    counter: int


@dataclass(frozen=True, slots=True)
class Emergency:
    """EMCY; code 0 says that the error is gone."""

    node: int
    code: int
    register: int
    maker: bytes


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """NMT state of a node."""

    node: int
    state: int


@dataclass(frozen=True, slots=True)
class BusOff:
    """The controller of this host left the bus."""


Event = Motion | Place | Emergency | Heartbeat | BusOff


def decode(identifier: int, data: bytes, error: bool = False) -> Event | None:
    """The event in a frame, None if it is none of ours (SDO answers go to the SDO client)."""
    if error:
        return BusOff() if identifier & ERROR_BUS_OFF else None
    function, node = identifier & ~0x7F, identifier & 0x7F
    if node == 0:
        return None
    if function == TPDO1 and len(data) == _TPDO1.size:
        return Motion(node, *_TPDO1.unpack(data))
    if function == TPDO2 and len(data) == _TPDO2.size:
        return Place(node, *_TPDO2.unpack(data))
    if function == EMERGENCY and len(data) == _EMERGENCY.size:
        return Emergency(node, *_EMERGENCY.unpack(data))
    if function == HEARTBEAT and len(data) == 1:
        return Heartbeat(node, data[0] & 0x7F)
    return None


def rpdo1(controlword: int, target_velocity: int) -> bytes:
    """6040h and 60FFh."""
    return _RPDO1.pack(controlword, target_velocity)
