"""Present limits and ramps in the dictionary, in rev and rev/s of the motor."""

from simulator.drive.dictionary import Dictionary
from simulator.drive.units import INCREMENTS, PER_MILLE, speed_unit


class Limits:
    """A view of one dictionary; only the unit of speed, a constant, is stored. Raises ScenarioError for an unsupported
    unit.
    """

    def __init__(self, dictionary: Dictionary) -> None:
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

    @property
    def acceleration(self) -> float:
        """6083h."""
        return self._ramp(0x6083)

    @property
    def deceleration(self) -> float:
        """6084h."""
        return self._ramp(0x6084)

    @property
    def quick_deceleration(self) -> float:
        """6085h."""
        return self._ramp(0x6085)

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

    def _ramp(self, index: int) -> float:
        return max(self._dictionary[index, 0], 1) / self.speed_unit
