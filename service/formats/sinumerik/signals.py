"""Signals and parameters of a SINAMICS drive, which the files of the control identify by number.

The number of a signal is that of its display parameter (SINAMICS S120/S150 List Manual): r0061 is the actual speed.
Numbers that occur in no available file are not guessed.
"""

from dataclasses import dataclass
from enum import Enum

DRIVE, CONTROL = 5, 6  # platforms of signals and parameters


class Quantity(Enum):
    """A quantity on the motor side; units of a linear motor are m/s and N."""

    SPEED = "speed"  # rad/s
    SPEED_SETPOINT = "speed set-point"  # rad/s
    TORQUE = "torque"  # N m
    CURRENT = "torque-forming current"  # A


@dataclass(frozen=True, slots=True)
class Meaning:
    """Name, quantity and unit of a drive's signal."""

    name: str
    quantity: Quantity
    unit: str


SIGNALS = {
    61: Meaning("r0061 speed actual value", Quantity.SPEED, "rad/s"),
    62: Meaning("r0062 speed set-point after the filter", Quantity.SPEED_SETPOINT, "rad/s"),
    63: Meaning("r0063 speed actual value, smoothed", Quantity.SPEED, "rad/s"),
    77: Meaning("r0077 torque-forming current set-point", Quantity.CURRENT, "A"),
    78: Meaning("r0078 torque-forming current actual value", Quantity.CURRENT, "A"),
    80: Meaning("r0080 torque actual value", Quantity.TORQUE, "N m"),
}

GAIN = (DRIVE, 1460)
PARAMETERS = {
    GAIN: "p1460 speed controller gain, N m s/rad",
    (DRIVE, 1462): "p1462 speed controller reset time, ms",
    (DRIVE, 1656): "p1656 current set-point filters active",
    (CONTROL, 32200): "MD32200 position controller gain",
    (CONTROL, 32500): "MD32500 friction compensation active",
    (CONTROL, 36000): "MD36000 exact stop coarse, mm or deg",
    (CONTROL, 36010): "MD36010 exact stop fine, mm or deg",
    (CONTROL, 36030): "MD36030 standstill tolerance, mm or deg",
    (CONTROL, 36400): "MD36400 contour monitoring tolerance, mm or deg",
}
