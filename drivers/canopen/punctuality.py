"""Periodic deadlines, how well they are kept, and when they are kept too badly. Pure."""

from array import array

import numpy as np

from drivers.ports import SetPointTiming


class Punctuality:
    """Missed deadlines are counted and left out, never compensated by a burst: only the wall clock shifts."""

    def __init__(self, period: float, allowed: int, limit: float) -> None:
        """`period` s; more than `allowed` missed deadlines, or one lateness above `limit` s, is an error."""
        self._period, self._allowed, self._limit = period, allowed, limit
        self._lateness = array("d")
        self._missed = 0
        self._worst = 0.0
        self.due = 0.0
        """The next deadline, s on the monotonic clock."""

    def begin(self, at: float) -> None:
        """Set the first deadline."""
        self.due = at

    def sent(self, at: float) -> float:
        """A cycle is sent at this time. Returns the lateness after the last passed deadline, s; negative: early."""
        late = at - self.due
        passed = max(0, int(late / self._period))
        self._lateness.append(late)
        self._missed += passed
        self._worst = max(self._worst, late)
        self.due += (1 + passed) * self._period
        return late - passed * self._period

    @property
    def patient(self) -> bool:
        """Whether a further deadline may be missed."""
        return self._missed < self._allowed

    @property
    def verdict(self) -> str | None:
        """Why the host is too late; None if it is not."""
        if self._worst > self._limit:
            return f"a set-point was {self._worst:.3f} s late, {self._limit:g} s are the limit"
        if self._missed > self._allowed:
            return (
                f"{self._missed} deadlines of {self._period * 1e3:g} ms were missed, {self._allowed} are allowed; "
                f"the worst set-point was {self._worst * 1e3:.1f} ms late"
            )
        return None

    def timing(self, source: str) -> SetPointTiming:
        """Punctuality so far; from any thread."""
        lateness = self._lateness.tolist()  # an atomic copy: the array may grow meanwhile
        median = float(np.median(lateness)) if lateness else 0.0
        return SetPointTiming(source, len(lateness), self._missed, median, self._worst)
