"""The table of makers: what no dictionary says of a drive. Its units, the objects inside, special behaviour.

Sources: docs/reference/virtual-drive.md for the virtual drive; maxon "EPOS4 Firmware Specification"; Elmo "DSP 402
Implementation Guide" (MAN-CAN402IG) and "Gold DS-402"; SCHUNK "CANopen" of the Powerball and its ROS configuration
(cob_robots); CiA 301 and CiA 402-2 for the plain drive.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

Key = tuple[int, int]


class Scaling(Enum):
    """How position units are derived from the encoder."""

    RESOLUTION = "608Fh increments a motor revolution, over the gear ratio 6091h"
    ENCODER = "increments of the encoder, a motor revolution"
    FEED = "encoder counts times feed constant 6092h, over 608Fh and 6091h"
    FACTORS = "encoder counts over 6093h, counts a second over 6094h"
    JOINT = "10^-3 degrees behind the gear"


@dataclass(frozen=True, slots=True, kw_only=True)
class Maker:
    """One drive family. `absent`: internal values of objects that are missing or have no value in the file."""

    name: str
    scaling: Scaling = Scaling.RESOLUTION
    increments: int = 0  # of the encoder per motor revolution, if no object gives them
    torque_unit: float = 1e-3  # N m per unit of 6076h
    motor_speed_in_rpm: bool = True  # 6080h; else in units of velocity
    acceleration_in_rpm: bool = False  # per second; else in units of velocity per second
    position_limit_code: int = 0x8612
    refuses_modes: bool = True  # an unsupported 6060h is aborted; else accepted, and 6061h does not change
    remaps_operational: bool = True  # PDOs may be configured in NMT operational
    absent: Mapping[Key, int | float] = field(default_factory=dict[Key, int | float])
    registers: Mapping[int, int] = field(default_factory=lambda: {0x81: 0x11, 0x82: 0x11, 0x90: 0x81, 0xFF: 0x81})
    """1001h by error code or its high byte: generic with communication, device profile (21h, all others) or maker."""
    pdo_identifiers: range | None = None  # of valid PDOs; None: all that CiA 301 does not reserve, of any PDO
    tells_length: bool = False  # whether a download of a wrong length is aborted as too long or too short


_WITHIN: dict[int, range] = {
    **dict.fromkeys((0x1001, 0x1017, 0x603F, 0x6040, 0x6041, 0x6060, 0x6061, 0x6064, 0x606C), range(1)),
    **dict.fromkeys((0x6077, 0x607A, 0x6081, 0x60FF), range(1)),
    **dict.fromkeys((0x1016, 0x2120, 0x2130), range(1, 2)),
    **dict.fromkeys((0x1018, 0x2104, 0x2140), range(1, 5)),
    **dict.fromkeys((0x2101, 0x2102, 0x2103), range(1, 17)),
    0x1003: range(9),
    0x2100: range(1, 13),
    0x2110: range(1, 4),
}

VIRTUAL = Maker(
    name="virtual",
    # Without 607Dh: no window but the range of the encoder. Limits of the motor (6072h, 6080h) apply in any case.
    absent=dict.fromkeys([(index, sub) for index, subs in _WITHIN.items() for sub in subs], 0)
    | {
        (0x1006, 0): 4000,
        (0x2100, 0x0A): 4,
        (0x2110, 2): 512,
        (0x2121, 1): 100,
        (0x2121, 2): 10,
        (0x6007, 0): 1,
        (0x605A, 0): 2,
        (0x605B, 0): 1,
        (0x605C, 0): 1,
        (0x605D, 0): 1,
        (0x605E, 0): 2,
        (0x6065, 0): 1 << 20,
        (0x6066, 0): 100,
        (0x6067, 0): 1049,
        (0x6072, 0): 5000,
        (0x6076, 0): 1000,
        (0x607D, 1): -(1 << 31),
        (0x607D, 2): (1 << 31) - 1,
        (0x607F, 0): 0xFFFFFFFF,
        (0x6080, 0): 0xFFFFFFFF,
        (0x6083, 0): 1000,
        (0x6084, 0): 1000,
        (0x6085, 0): 5000,
        (0x60A9, 0): 0xFDB44700,  # 10^-3 rev/min
        (0x60C2, 1): 4,
        (0x60C2, 2): -3,
        (0x60E0, 0): 5000,
        (0x60E1, 0): 5000,
    },
    registers={0x2310: 0x03, 0x8130: 0x11, 0x8250: 0x11, 0x8700: 0x11, 0x9000: 0x81},
    pdo_identifiers=range(0x181, 0x580),
    tells_length=True,
)
"""The virtual drive: the same drive if its EDS lacks an object, but the object is not on the bus."""

_OPTIONS: dict[Key, int | float] = {
    (0x1000, 0): 0x00020192,  # servo drive, CiA 402
    (0x1005, 0): 0x80,
    (0x1029, 1): 0,  # a communication error leads to pre-operational (CiA 301)
    (0x6007, 0): 1,  # fault
    (0x605A, 0): 2,
    (0x605B, 0): 0,
    (0x605C, 0): 1,
    (0x605D, 0): 1,
    (0x605E, 0): 2,
    (0x6502, 0): 0x0000_0105,  # pp, pv, csv
}


def maker_of(vendor: int, vendor_name: str, product_name: str) -> Maker:
    """By vendor id (1018h:01 or [DeviceInfo]) and the names in [DeviceInfo]; the standard drive for all others."""
    if vendor == 0xFB:
        return Maker(
            name="maxon EPOS4",
            scaling=Scaling.ENCODER,
            torque_unit=1e-6,
            motor_speed_in_rpm=False,
            acceleration_in_rpm=True,
            position_limit_code=0x8A82,
            remaps_operational=False,
            absent=_OPTIONS,
        )
    if vendor == 0x9A and product_name.startswith("Gold"):
        absent = _OPTIONS | {(0x6502, 0): 0x3ED}
        return Maker(name="Elmo Gold", scaling=Scaling.FEED, increments=65536, absent=absent)
    if vendor == 0x9A:
        return Maker(name="Elmo SimplIQ", scaling=Scaling.FACTORS, increments=8192, absent=_OPTIONS)
    if vendor_name.startswith("SCHUNK"):
        return Maker(name="SCHUNK Powerball", scaling=Scaling.JOINT, refuses_modes=False, absent=_OPTIONS)
    return Maker(name="plain CiA 402", refuses_modes=False, absent=_OPTIONS)
