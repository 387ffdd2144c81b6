"""What is said of the machine's state, computed here and nowhere else: from what the drives report and how old that is.

It never says better than the truth at the time of the report: a drive that is silent, or whose last report is older
than `STALE`, is `unknown`; an axis that reports energy, or gets energy from this service, is never `stands`. Pure but
for the clock, which is monotonic.
"""

import math
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import Enum

from drivers.ports import AxisState, AxisStatus


class Condition(Enum):
    """Ordered: the machine is in the first of these in which one of its axes is."""

    MOVES = "moves"
    UNKNOWN = "unknown"
    ENERGISED = "energised"  # reports standstill, with energy
    STANDS = "stands"  # reports standstill and no energy


@dataclass(frozen=True, slots=True)
class AxisStatement:
    """`age`: s since the drive was asked for this report; None: it never reported. `reason`: why it is unknown."""

    state: Condition
    age: float | None
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Statement:
    """The whole machine: the worst of its axes, and the greatest age."""

    state: Condition
    age: float | None
    reason: str
    axes: Mapping[str, AxisStatement]


NO_MACHINE = Statement(Condition.UNKNOWN, None, "", {})


class Reports:
    """The last report of each drive. Written by the event loop; `statement` may be called from any thread."""

    stale = 2.0  # s; a report that is older says nothing of now

    def __init__(self, joints: Iterable[str], clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._joints = tuple(joints)
        self._lost = "not connected yet"
        self._last: dict[str, tuple[AxisStatus, float]] = {}  # and the time at which the drive was asked
        self._silent: dict[str, str] = {}  # why a drive did not answer when it was last asked
        self._energy_until = dict.fromkeys(self._joints, -math.inf)  # before this an axis may have got energy

    def connected(self) -> None:
        """What was reported by an earlier connection counts no more."""
        self._lost = ""
        self._last.clear()
        self._silent.clear()

    def lost(self, why: str) -> None:
        """No drive is asked any more; `why` is the reason of every axis."""
        self._lost = why

    def note(self, status: Mapping[str, AxisStatus], asked: float) -> None:
        """What the drives answered to a question that began at `asked`, s on the clock."""
        for joint, axis in status.items():
            if axis.state is AxisState.UNKNOWN or not math.isfinite(axis.velocity):
                self._silent[joint] = "the drive does not answer"
            else:
                self._silent.pop(joint, None)
                self._last[joint] = axis, asked

    def gets_energy(self, joints: Iterable[str]) -> None:
        """From now on these axes may have energy, whatever they reported before."""
        self._energy_until.update(dict.fromkeys(joints, math.inf))

    def gave_energy_up(self, joints: Iterable[str]) -> None:
        """From now on what these axes report counts again."""
        now = self._clock()
        self._energy_until.update({joint: now for joint in joints if self._energy_until[joint] == math.inf})

    @property
    def statement(self) -> Statement:
        """As of now."""
        axes = {joint: self._axis(joint) for joint in self._joints}
        state = next(one for one in Condition if any(axis.state is one for axis in axes.values()))
        ages = [axis.age for axis in axes.values()]
        age = None if None in ages else max(each for each in ages if each is not None)
        reasons = dict.fromkeys(axis.reason for axis in axes.values() if axis.reason)
        named = "; ".join(f"{joint}: {axis.reason}" for joint, axis in axes.items() if axis.reason)
        return Statement(state, age, next(iter(reasons)) if len(reasons) == 1 else named, axes)

    def _axis(self, joint: str) -> AxisStatement:
        last = self._last.get(joint)
        age = None if last is None else max(0.0, self._clock() - last[1])
        reason = self._lost or self._silent.get(joint, "")
        if not reason and (last is None or age is None):
            reason = "no report yet"
        if not reason and age is not None and age > Reports.stale:
            reason = f"the last report is {age:.1f} s old, limit {Reports.stale:g} s"
        if reason or last is None:
            return AxisStatement(Condition.UNKNOWN, age, reason)
        status, asked = last
        if not status.stands:
            return AxisStatement(Condition.MOVES, age)
        if status.energised or self._energy_until[joint] == math.inf:
            return AxisStatement(Condition.ENERGISED, age)
        if asked <= self._energy_until[joint]:
            return AxisStatement(Condition.UNKNOWN, age, "no report since it had energy")
        return AxisStatement(Condition.STANDS, age)
