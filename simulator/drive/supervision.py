"""What an enabled axis may not do: leave the position limits, run too fast, lag behind, stay at its torque limit."""

import numpy as np

from simulator.drive.dictionary import Dictionary
from simulator.drive.errors import ErrorCode
from simulator.drive.measuring import Samples
from simulator.drive.units import INCREMENTS, SPEED

_OVERSPEED = 1.1
_MEAN_OF = 0.01  # s, over which the speed is averaged
_LIMITED_FOR = 0.1  # s at the torque limit


class Supervision:
    """Judges the samples of each chunk of cycles against the dictionary's limits."""

    def __init__(self, dictionary: Dictionary, cycle: float) -> None:
        self._dictionary = dictionary
        self._cycle = cycle
        self._speeds: list[float] = []
        self._limited = 0.0
        self._lagging = 0.0

    @property
    def limited(self) -> bool:
        """Whether the torque is at its limit just now."""
        return self._limited > 0

    def check(self, samples: Samples, command: float, following_error: float) -> ErrorCode | None:
        """The fault in these samples, if any; `command` in rev/s, `following_error` in rev.

        The position limits hold for where the axis would come to stand by the quick stop ramp, with the
        position window 6067h as tolerance.
        """
        d = self._dictionary
        span = len(samples.speed) * self._cycle
        self._limited = self._limited + span if samples.torque_limited.all() else 0.0
        self._lagging = self._lagging + span if abs(following_error) * INCREMENTS > d[0x6065, 0] else 0.0
        ahead = samples.position[-1] + command * abs(command) / (2 * d[0x6085, 0] / SPEED)
        tolerance = d[0x6067, 0]
        if command > 0 and ahead * INCREMENTS > d[0x607D, 2] + tolerance:
            return ErrorCode.POSITION_LIMIT
        if command < 0 and ahead * INCREMENTS < d[0x607D, 1] - tolerance:
            return ErrorCode.POSITION_LIMIT
        if self._too_fast(samples):
            return ErrorCode.SPEED_LIMIT
        if self._lagging > d[0x6066, 0] * 1e-3:
            return ErrorCode.FOLLOWING
        return ErrorCode.TORQUE_LIMIT if self._limited > _LIMITED_FOR else None

    def _too_fast(self, samples: Samples) -> bool:
        self._speeds.extend(samples.speed.tolist())
        if len(self._speeds) * self._cycle < _MEAN_OF:
            return False
        mean = abs(float(np.mean(self._speeds)))
        self._speeds.clear()
        return mean * SPEED > _OVERSPEED * self._dictionary[0x6080, 0]
