"""The current motion in a run of a campaign, as known by the code that moves the machine."""

from collections.abc import Sequence
from dataclasses import dataclass

from service.planning.safety.travel import Leg


@dataclass(frozen=True, slots=True)
class Travel:
    """One joint moves to `target`, rad (m); `seconds` at the speed of moves between poses."""

    joint: str
    target: float
    seconds: float


@dataclass(frozen=True, slots=True)
class CurrentActivity:
    """A sweep, or those of a trajectory, with the remaining moves to its pose.

    `travels`: the first one is in progress, the others follow; empty: the sweep itself. `seconds`: of the sweep.
    `checked`: joints that made their check move since the last start or resume. `begun`: monotonic clock, s.
    """

    numbers: tuple[int, ...]
    joints: tuple[str, ...]
    travels: tuple[Travel, ...]
    seconds: float
    checked: frozenset[str]
    begun: float


def travels(joints: Sequence[str], here: Sequence[float], legs: Sequence[Leg], velocity: float) -> tuple[Travel, ...]:
    """Moves from the pose `here`, rad (m), at `velocity`, rad/s (m/s)."""
    pose = list(here)
    found: list[Travel] = []
    for index, target in legs:
        found.append(Travel(joints[index], target, abs(target - pose[index]) / velocity))
        pose[index] = target
    return tuple(found)
