"""Cyclic synchronous velocity: the set-point 60FFh between two SYNCs, and the monitoring of both."""

import math

from simulator.drive.dictionary import Dictionary
from simulator.drive.errors import ErrorCode
from simulator.drive.limits import Limits


class CyclicVelocity:
    """Set-point of the present cycle in rev/s, and monitoring of SYNC and set-points (2121h)."""

    def __init__(self, dictionary: Dictionary, limits: Limits) -> None:
        self._dictionary = dictionary
        self._limits = limits
        dictionary.on_download((0x60FF, 0), self._received)
        self.restart()

    def restart(self) -> None:
        """Start from standstill: no set-point and no SYNC received yet."""
        self.goal = 0.0
        self._dictionary[0x60FF, 0] = 0
        self._last_sync: float | None = None
        self._missing = 0
        self._fresh = False  # a set-point came since the last SYNC

    @property
    def period_agrees(self) -> bool:
        """Whether 60C2h and 1006h agree."""
        period = self._dictionary[0x60C2, 1] * 10.0 ** self._dictionary[0x60C2, 2]
        return math.isclose(period, self._dictionary[0x1006, 0] * 1e-6)

    @property
    def watch_until(self) -> float | None:
        """Time at which SYNC counts as missing, s; None before the first SYNC."""
        return None if self._last_sync is None else self._last_sync + self._dictionary[0x2121, 1] * 1e-3

    def sync(self, now: float) -> ErrorCode | None:
        """Use the set-point received before this SYNC as target. Returns the fault if it is missing or not allowed."""
        self._last_sync = now
        self._missing = 0 if self._fresh else self._missing + 1
        self._fresh = False
        goal = self._dictionary[0x60FF, 0] / self._limits.speed_unit
        if self._missing > self._dictionary[0x2121, 2]:
            return ErrorCode.SET_POINT_MISSING
        if abs(goal) > self._limits.speed:
            return ErrorCode.SPEED_LIMIT
        self.goal = goal
        return None

    def _received(self, _: int) -> None:
        self._fresh = True
