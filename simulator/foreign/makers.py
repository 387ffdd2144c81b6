"""Properties of a drive that its file does not contain: units, defaults of missing objects, and special behaviour.

Sources: maxon "EPOS4 Firmware Specification"; Elmo "DSP 402 Implementation Guide" (MAN-CAN402IG) and "Gold DS-402";
SCHUNK "CANopen" of the Powerball and its ROS configuration (cob_robots); CiA 301 and CiA 402-2 for the plain drive.
"""

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


@dataclass(frozen=True, slots=True)
class Maker:
    """One drive family. `absent`: internal values of objects that are missing or have no value in the file."""

    name: str
    scaling: Scaling
    increments: int = 0  # of the encoder per motor revolution, if no object gives them
    torque_unit: float = 1e-3  # N m per unit of 6076h
    motor_speed_in_rpm: bool = True  # 6080h; else in units of velocity
    acceleration_in_rpm: bool = False  # per second; else in units of velocity per second
    position_limit_code: int = 0x8612
    refuses_modes: bool = False  # an unsupported 6060h is aborted; else accepted, and 6061h does not change
    remaps_operational: bool = True  # PDOs may be configured in NMT operational
    absent: dict[Key, int] = field(default_factory=dict[Key, int])


_OPTIONS: dict[Key, int] = {
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

PLAIN = Maker("plain CiA 402", Scaling.RESOLUTION, absent=_OPTIONS)

EPOS4 = Maker(
    "maxon EPOS4",
    Scaling.ENCODER,
    torque_unit=1e-6,
    motor_speed_in_rpm=False,
    acceleration_in_rpm=True,
    position_limit_code=0x8A82,
    refuses_modes=True,
    remaps_operational=False,
    absent=_OPTIONS,
)

GOLD = Maker(
    "Elmo Gold",
    Scaling.FEED,
    increments=65536,
    refuses_modes=True,
    absent=_OPTIONS | {(0x6502, 0): 0x3ED},
)

SIMPLIQ = Maker("Elmo SimplIQ", Scaling.FACTORS, increments=8192, refuses_modes=True, absent=_OPTIONS)

POWERBALL = Maker("SCHUNK Powerball", Scaling.JOINT, absent=_OPTIONS)


def maker_of(vendor: int, vendor_name: str, product_name: str) -> Maker:
    """By vendor id (1018h:01 or [DeviceInfo]) and the names in [DeviceInfo]; the standard drive for all others."""
    if vendor == 0xFB:
        return EPOS4
    if vendor == 0x9A:
        return GOLD if product_name.startswith("Gold") else SIMPLIQ
    return POWERBALL if vendor_name.startswith("SCHUNK") else PLAIN
