"""The object dictionary of one drive: CiA 402 in the units of a motor with a gear, nothing of a maker's."""

import math
from typing import Any

from durand import Array, MinimalNode, Record, Variable
from durand.datatypes import DatatypeEnum as DT

VENDOR, PRODUCT, REVISION = 0x0000_0D0A, 0x402, 0x0001_0000
ENCODER = 65536  # increments a motor revolution
SPEED_UNIT, SPEEDS = 0xFDB44700, 60_000.0  # 10^-3 rev/min; so many in 1 rev/s
GEAR = 100.0
RATED = 20.0  # N m of the motor
MOST = 2000  # per mille of it
MODES = {"csv": 1 << 8 | 1 << 2 | 1, "pv": 1 << 2 | 1}  # 6502h; profile position is in both

TURN = GEAR / math.tau  # motor revolutions in 1 rad of the joint
RAMP = round(2.0 * TURN * SPEEDS)  # 2 rad/s^2

I8, U8, I16, U16, I32, U32 = DT.INTEGER8, DT.UNSIGNED8, DT.INTEGER16, DT.UNSIGNED16, DT.INTEGER32, DT.UNSIGNED32
_OPTIONS = {0x6007: (0, 1, 2, 3), 0x605A: (2, 6), 0x605B: (0, 1), 0x605C: (0, 1), 0x605D: (1, 2), 0x605E: (1, 2)}


def variables(modes: int) -> list[tuple[int, Variable]]:
    def one(index: int, kind: DT, access: str, value: int, name: str) -> tuple[int, Variable]:
        return index, Variable(kind, access, value, name=name)

    fastest = round(1.2 * TURN * SPEEDS)
    return [
        one(0x1006, U32, "rw", 0, "Communication Cycle Period"),
        *(one(index, I16, "rw", options[-1] if index == 0x605E else 1 if index != 0x605A else 2, f"Option {index:X}")
          for index, options in _OPTIONS.items()),
        one(0x603F, U16, "ro", 0, "Error Code"),
        one(0x6040, U16, "rw", 0, "Controlword"),
        one(0x6041, U16, "ro", 0x240, "Statusword"),
        one(0x6060, I8, "rw", 0, "Mode"),
        one(0x6061, I8, "ro", 0, "Mode Display"),
        one(0x6064, I32, "ro", 0, "Position"),
        one(0x606C, I32, "ro", 0, "Velocity"),
        one(0x6072, U16, "rw", MOST, "Max Torque"),
        one(0x6076, U32, "ro", round(RATED * 1e3), "Rated Torque"),
        one(0x6077, I16, "ro", 0, "Torque"),
        one(0x607A, I32, "rw", 0, "Target Position"),
        one(0x607F, U32, "rw", fastest, "Max Profile Velocity"),
        one(0x6080, U32, "rw", round(1.2 * TURN * 60), "Max Motor Speed"),  # rev/min
        one(0x6081, U32, "rw", 0, "Profile Velocity"),
        *(one(index, U32, "rw", RAMP, f"Ramp {index:X}") for index in (0x6083, 0x6084, 0x6085)),
        one(0x60A9, U32, "ro", SPEED_UNIT, "Velocity Unit"),
        one(0x60B1, I32, "rw", 0, "Velocity Offset"),
        one(0x60FF, I32, "rw", 0, "Target Velocity"),
        one(0x6502, U32, "ro", modes, "Supported Modes"),
    ]  # fmt: skip


def records() -> list[tuple[int, Record]]:
    end = round(3.2 * TURN * ENCODER)
    given: dict[int, tuple[str, list[tuple[DT, str, int]]]] = {
        0x607D: ("Position Limits", [(I32, "rw", -end), (I32, "rw", end)]),
        0x608F: ("Encoder Resolution", [(U32, "ro", ENCODER), (U32, "ro", 1)]),
        0x60C2: ("Interpolation Period", [(U8, "rw", 8), (I8, "rw", -3)]),
    }
    made: list[tuple[int, Record]] = []
    for index, (name, subs) in given.items():
        record = Record(name=name)
        for sub, (kind, access, value) in enumerate(subs, 1):
            record[sub] = Variable(kind, access, value, name=f"{name} {sub}")
        made.append((index, record))
    return made


def furnish(node: MinimalNode, modes: int, serial: int) -> None:
    """All objects of a drive, and who it is."""
    od: Any = node.object_dictionary
    for index, thing in (*variables(modes), *records()):
        od[index] = thing
    od[0x1016] = Array(Variable(U32, "rw", 0, name="Consumer Heartbeat"), length=1, name="Consumer Heartbeat Time")
    od.write(0x1000, 0, 0x0002_0192)
    for sub, value in enumerate((VENDOR, PRODUCT, REVISION, serial), 1):
        od.write(0x1018, sub, value)
    for index, allowed in _OPTIONS.items():
        od.validate_callbacks[index, 0].add(lambda value, allowed=allowed: _refuse(value not in allowed))
    od.validate_callbacks[0x6060, 0].add(lambda value: _refuse(value != 0 and not modes >> (value - 1) & 1))
    node.eds.device_info.VendorName = "durand"
    node.eds.device_info.VendorNumber = VENDOR


def _refuse(wrong: bool) -> None:
    if wrong:
        raise ValueError("not supported")
