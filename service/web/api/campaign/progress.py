"""Progress of a campaign, its remaining time, and what moves now and next. The page and the commands use it."""

import time
from collections.abc import Sequence
from itertools import pairwise
from statistics import median
from typing import Literal

from pydantic import BaseModel

from service.machine.execution.sweep_executor import DURATION, CheckMove, CurrentActivity
from service.planning.campaigns.stored_plan import PlannedTime
from service.store.documents import CampaignState, SweepDocument, SweepState, SweepStatus

CHECK_MOVE = 2 * DURATION + 1.0  # s: motion in both directions, switching on and off

_LEFT = (SweepState.PLANNED, SweepState.RUNNING)
_RECORDED = (SweepState.RECORDED, SweepState.IDENTIFIED)
_AGAIN = (SweepState.FAILED, SweepState.INTERRUPTED)
_OPEN = (CampaignState.PLANNED, CampaignState.RUNNING, CampaignState.PAUSING, CampaignState.PAUSED)
_PAUSE = 2.0  # ratio to the median pace: the campaign was paused between two sweeps with a larger ratio


def expected_time(times: Sequence[PlannedTime]) -> float:
    """Duration of a campaign that has not begun, s: moves, sweeps, and one check move of each axis that moves."""
    moving = frozenset[str]().union(*(each.joints for each in times))
    return sum(each.duration for each in times) + CHECK_MOVE * len(moving)


class Progress(BaseModel):
    """Progress of the measurement: `done` sweeps of `total` are recorded; `current` is the sweep that runs.

    `remaining`: s, with moves, check moves and settling; for a paused campaign, the time after its resume. Null if
    it is not known. `repeat`: additional s if a resume repeats the failed and interrupted sweeps.
    """

    done: int
    total: int
    remaining: float | None
    repeat: float
    current: SweepDocument | None


class StepView(BaseModel):
    """One step of the machine: `travel` of an axis to `target` rad (m), its `check_move`, or the `sweep` itself.

    `seconds`: duration of the whole step, s; null if only the drives know it.
    """

    kind: Literal["check_move", "travel", "sweep"]
    axes: tuple[str, ...]
    target: float | None
    seconds: float | None


def progress(
    state: CampaignState,
    sweeps: Sequence[SweepStatus],
    times: Sequence[PlannedTime],
    under_way: CurrentActivity | None = None,
    now: float | None = None,
    current: SweepDocument | None = None,
) -> Progress:
    """Progress with the remaining time: the planned time of the sweeps left, times the pace of the recorded sweeps.

    `times`: () for a campaign without plan. `now`: s, of the clock of `under_way`. `current`: the sweep that runs.
    """
    left = [sweep for sweep in sweeps if sweep.state in _LEFT]
    predictable = state in _OPEN and len(times) == len(sweeps)
    remaining = _time_left(state, sweeps, times, under_way, now) if predictable and left else None
    return Progress(
        done=sum(sweep.state in _RECORDED for sweep in sweeps),
        total=len(sweeps),
        remaining=remaining if left else 0.0,
        repeat=_pace(sweeps, times) * _sum(sweeps, times, _AGAIN) if predictable else 0.0,
        current=current,
    )


def _time_left(
    state: CampaignState,
    sweeps: Sequence[SweepStatus],
    times: Sequence[PlannedTime],
    under_way: CurrentActivity | None,
    now: float | None,
) -> float:
    """Remaining time of a campaign with sweeps left, s."""
    pace, by_number = _pace(sweeps, times), dict(zip((sweep.number for sweep in sweeps), times, strict=True))
    left = [sweep.number for sweep in sweeps if sweep.state in _LEFT]
    moving = frozenset[str]().union(*(by_number[number].joints for number in left))
    checked: frozenset[str] = frozenset()
    if under_way is not None:
        checked = under_way.checked
    elif state in (CampaignState.RUNNING, CampaignState.PAUSING):
        checked = checked.union(*(by_number[each.number].joints for each in sweeps if each.attempt))
    seconds = pace * (sum(by_number[number].duration for number in left) + CHECK_MOVE * len(moving - checked))
    if under_way is not None:
        present = pace * sum(by_number[number].duration for number in under_way.numbers)
        seconds -= min((time.monotonic() if now is None else now) - under_way.begun, present)
    return seconds


def _sum(sweeps: Sequence[SweepStatus], times: Sequence[PlannedTime], states: Sequence[SweepState]) -> float:
    return sum(each.duration for sweep, each in zip(sweeps, times, strict=True) if sweep.state in states)


def _pace(sweeps: Sequence[SweepStatus], times: Sequence[PlannedTime]) -> float:
    """Ratio of measured to planned time from sweep to sweep; 1 below two sweeps. Pauses do not count."""
    ways: list[tuple[float, float]] = []
    recorded = sorted(
        ((sweep, each) for sweep, each in zip(sweeps, times, strict=True) if sweep.state in _RECORDED),
        key=lambda pair: pair[0].started_at,
    )
    for (before, planned_before), (after, planned) in pairwise(recorded):
        gap = planned.start - planned_before.start
        if after.number == before.number + 1 and gap > 0:
            ways.append((after.started_at - before.started_at, gap))
    if not ways:
        return 1.0
    usual = median(taken / gap for taken, gap in ways)
    counted = [(taken, gap) for taken, gap in ways if taken / gap <= _PAUSE * usual]
    return sum(taken for taken, _ in counted) / sum(gap for _, gap in counted)


def steps(under_way: CurrentActivity | None, check_move: CheckMove | None) -> tuple[StepView, ...]:
    """The step that moves now, then the steps up to the end of the present sweep; () while they are not known."""
    found: list[StepView] = []
    if check_move is not None:
        found.append(StepView(kind="check_move", axes=(check_move.joint,), target=None, seconds=2 * DURATION))
    if under_way is not None:
        found += [
            StepView(kind="travel", axes=(each.joint,), target=each.target, seconds=each.seconds)
            for each in under_way.travels
        ]
        found.append(StepView(kind="sweep", axes=under_way.joints, target=None, seconds=under_way.seconds))
    return tuple(found)
