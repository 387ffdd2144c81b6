"""Units of the virtual drive (docs/reference/virtual-drive.md, "Units"), and its limits in rev and rev/s of a motor."""

from simulator.drive.dictionary import ObjectDictionary, power_of_ten
from simulator.scenario import ScenarioError

INCREMENTS = 1 << 20
"""Position: increments per motor revolution, 608Fh."""

PER_MILLE = 1000
"""Torque relative to the rated torque 6076h, which is in 10^-3 N m."""


def speed_unit(dictionary: ObjectDictionary) -> float:
    """Units of speed (and, per second, of acceleration) in 1 rev/s by 60A9h. Raises ScenarioError for an unsupported
    unit.

    The code has one byte each for prefix (power of ten), numerator, denominator, 0 (CiA 303-2, CiA 402-2).
    """
    code, prefix = dictionary[0x60A9, 0], power_of_ten(dictionary[0x60A9, 0])
    numerator = {0xB4: 1.0, 0xB5: float(INCREMENTS)}.get(code >> 16 & 0xFF)  # revolutions, increments
    denominator = {0x03: 1.0, 0x47: 60.0}.get(code >> 8 & 0xFF)  # second, minute
    if numerator is None or denominator is None or abs(prefix) > 9:
        raise ScenarioError(f"60A9h: velocity unit {code:08X}h is not 10^x revolutions or increments per s or min")
    return numerator * denominator * 10.0**-prefix


class DriveLimits:
    """Present limits and ramps of one dictionary; only the unit of speed, a constant, is stored. Raises ScenarioError
    for an unsupported unit.
    """

    def __init__(self, dictionary: ObjectDictionary) -> None:
        self._dictionary = dictionary
        self.speed_unit = speed_unit(dictionary)

    @property
    def torque(self) -> float:
        """Minimum of 6072h, 60E0h, 60E1h, relative to the rated torque."""
        d = self._dictionary
        return min(d[0x6072, 0], d[0x60E0, 0], d[0x60E1, 0]) / PER_MILLE

    @property
    def speed(self) -> float:
        """6080h."""
        return self._dictionary[0x6080, 0] / self.speed_unit

    @property
    def profile_speed(self) -> float:
        """Of a move: minimum of 6081h, 607Fh, 6080h."""
        d = self._dictionary
        return min(d[0x6081, 0], d[0x607F, 0], d[0x6080, 0]) / self.speed_unit

    def ramp(self, index: int) -> float:
        """6083h, 6084h or 6085h."""
        return max(self._dictionary[index, 0], 1) / self.speed_unit

    @property
    def window(self) -> tuple[float, float]:
        """607Dh."""
        return self._dictionary[0x607D, 1] / INCREMENTS, self._dictionary[0x607D, 2] / INCREMENTS

    @property
    def position_window(self) -> float:
        """6067h."""
        return self._dictionary[0x6067, 0] / INCREMENTS

    @property
    def following_window(self) -> float:
        """6065h."""
        return self._dictionary[0x6065, 0] / INCREMENTS

    @property
    def following_time(self) -> float:
        """6066h, s."""
        return self._dictionary[0x6066, 0] * 1e-3
