"""Supervision of an enabled axis: position limits, speed, following error, time at the torque limit."""

import numpy as np

from simulator.drive.errors import ErrorCode
from simulator.drive.limits import Limits
from simulator.drive.measuring import Samples

_OVERSPEED = 1.1
_MEAN_OF = 0.01  # s, over which the speed is averaged
_LIMITED_FOR = 0.1  # s at the torque limit


class Supervision:
    """Checks the samples of each chunk of cycles against the limits of the axis."""

    def __init__(self, limits: Limits, cycle: float) -> None:
        self._limits = limits
        self._cycle = cycle
        self._speeds: list[float] = []
        self._limited = 0.0
        self._lagging = 0.0

    @property
    def limited(self) -> bool:
        """Whether the torque is at its limit now."""
        return self._limited > 0

    def check(self, samples: Samples, command: float, following_error: float) -> ErrorCode | None:
        """The fault in these samples, if any; `command` in rev/s, `following_error` in rev.

        The position limits apply to the position where the axis would come to standstill by the quick stop ramp,
        with the position window 6067h as tolerance.
        """
        limits = self._limits
        span = len(samples.speed) * self._cycle
        self._limited = self._limited + span if samples.torque_limited.all() else 0.0
        self._lagging = self._lagging + span if abs(following_error) > limits.following_window else 0.0
        ahead = float(samples.position[-1]) + command * abs(command) / (2 * limits.quick_deceleration)
        low, high = limits.window
        tolerance = limits.position_window
        if (command > 0 and ahead > high + tolerance) or (command < 0 and ahead < low - tolerance):
            return ErrorCode.POSITION_LIMIT
        if self._too_fast(samples):
            return ErrorCode.SPEED_LIMIT
        if self._lagging > limits.following_time:
            return ErrorCode.FOLLOWING
        return ErrorCode.TORQUE_LIMIT if self._limited > _LIMITED_FOR else None

    def _too_fast(self, samples: Samples) -> bool:
        self._speeds.extend(samples.speed.tolist())
        if len(self._speeds) * self._cycle < _MEAN_OF:
            return False
        mean = abs(float(np.mean(self._speeds)))
        self._speeds.clear()
        return mean > _OVERSPEED * self._limits.speed
