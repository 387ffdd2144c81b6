"""Units of the dictionary and rev, rev/s of the motor (docs/reference/virtual-drive.md, "Units")."""

from simulator.drive.dictionary import Dictionary
from simulator.scenario import ScenarioError

INCREMENTS = 1 << 20
"""Position: increments per motor revolution, 608Fh."""

SPEED = 60_000
"""Speed and acceleration without 60A9h: units of 10^-3 rev/min (per s) in 1 rev/s (per s)."""

PER_MILLE = 1000
"""Torque relative to the rated torque 6076h, which is in 10^-3 N m."""

_NUMERATORS = {0xB4: 1.0, 0xB5: float(INCREMENTS)}  # revolutions, increments
_DENOMINATORS = {0x03: 1.0, 0x47: 60.0}  # second, minute


def speed_unit(dictionary: Dictionary) -> float:
    """Units of speed (and, per second, of acceleration) in 1 rev/s by 60A9h. Raises ScenarioError for an unsupported
    unit.

    The code has one byte each for prefix (power of ten), numerator, denominator, 0 (CiA 303-2, CiA 402-2).
    """
    code = dictionary[0x60A9, 0]
    prefix = (code >> 24) - (256 if code >> 31 else 0)
    numerator, denominator = _NUMERATORS.get(code >> 16 & 0xFF), _DENOMINATORS.get(code >> 8 & 0xFF)
    if numerator is None or denominator is None or abs(prefix) > 9:
        raise ScenarioError(f"60A9h: velocity unit {code:08X}h is not 10^x revolutions or increments per s or min")
    return numerator * denominator * 10.0**-prefix


def clamp(value: float, bits: int) -> int:
    """The nearest signed integer of `bits` bits."""
    top = (1 << (bits - 1)) - 1
    return max(-top - 1, min(top, round(value)))
