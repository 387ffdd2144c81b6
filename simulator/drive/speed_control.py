"""Gain and reset time of the speed controller (2140h), N m s/rad of the motor and s.

The active values are in RAM and may be softened while the axis moves; the commissioned values are stored and
read-only.
"""

from simulator.drive.dictionary import Abort, AbortCode, Dictionary


class SpeedControl:
    """A view of one dictionary."""

    def __init__(self, dictionary: Dictionary) -> None:
        self._dictionary = dictionary
        dictionary.on_download((0x2140, 1), self._check_gain)
        dictionary.on_download((0x2140, 2), self._check_reset_time)

    @property
    def active(self) -> tuple[float, float]:
        """Present gain and reset time."""
        return self._dictionary[0x2140, 1], self._dictionary[0x2140, 2]

    @property
    def softened(self) -> bool:
        """Whether the active values differ from the commissioned ones."""
        return self.active != (self._dictionary[0x2140, 3], self._dictionary[0x2140, 4])

    def restore(self) -> None:
        """Set the commissioned values."""
        d = self._dictionary
        d[0x2140, 1], d[0x2140, 2] = d[0x2140, 3], d[0x2140, 4]

    def _check_gain(self, value: float) -> None:
        if not value > 0:
            raise Abort(AbortCode.TOO_LOW)
        if value > self._dictionary[0x2140, 3]:
            raise Abort(AbortCode.TOO_HIGH)

    def _check_reset_time(self, value: float) -> None:
        if not value >= self._dictionary[0x2140, 4]:
            raise Abort(AbortCode.TOO_LOW)
        if value == float("inf"):
            raise Abort(AbortCode.TOO_HIGH)
