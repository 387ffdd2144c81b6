"""How far a campaign is, how long it still takes, and what moves now and next: one answer for page and commands."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import median
from typing import Any, Literal

from pydantic import BaseModel

from service.execution.check_move import DURATION, CheckMove
from service.execution.under_way import UnderWay
from service.store.documents import CampaignState, SweepDocument, SweepState

CHECK_MOVE = 2 * DURATION + 1.0  # s, there and back, with switching on and off

_LEFT = (SweepState.PLANNED, SweepState.RUNNING)
_RECORDED = (SweepState.RECORDED, SweepState.IDENTIFIED)
_AGAIN = (SweepState.FAILED, SweepState.INTERRUPTED)
_OPEN = (CampaignState.PLANNED, CampaignState.RUNNING, CampaignState.PAUSING, CampaignState.PAUSED)
_PAUSE = 2.0  # times the usual pace: between two such sweeps the campaign was held


class Progress(BaseModel):
    """How far the measuring is: `done` sweeps recorded of `total`; `current` is the sweep that runs.

    `remaining` s with moves, check moves and settling; of a paused campaign from its resume on. Null where it cannot
    be told. `repeat` s more if a resume has failed and interrupted sweeps measured again.
    """

    done: int
    total: int
    remaining: float | None
    repeat: float
    current: SweepDocument | None


class StepView(BaseModel):
    """One thing the machine does: `travel` of an axis to `target` rad (m), its `check_move`, or the `sweep` itself.

    `seconds`: of the whole step, null where the drives alone know.
    """

    kind: Literal["check_move", "travel", "sweep"]
    axes: tuple[str, ...]
    target: float | None
    seconds: float | None


@dataclass(frozen=True)
class PlannedTime:
    """What a plan says of a sweep: s with the way to it, its start in the plan, and the joints that it moves."""

    duration: float
    start: float
    joints: frozenset[str]


def planned_times(document: Mapping[str, Any]) -> tuple[PlannedTime, ...]:
    """By sweep, of the document of any stored plan."""
    return tuple(
        PlannedTime(
            sweep["duration"],
            sweep["spec"]["started_at"],
            frozenset({sweep["spec"]["axis"], *(leg["joint"] for leg in sweep["legs"])}),
        )
        for sweep in document["sweeps"]
    )


def progress(
    state: CampaignState,
    sweeps: Sequence[SweepDocument],
    times: Sequence[PlannedTime],
    under_way: UnderWay | None = None,
    now: float | None = None,
) -> Progress:
    """Remaining time: what the plan says of the sweeps left, at the pace of the sweeps so far.

    `times` () for a campaign without plan. `now`: of the clock of `under_way`, s.
    """
    left = [sweep for sweep in sweeps if sweep.state in _LEFT]
    told = state in _OPEN and len(times) == len(sweeps)
    remaining = _time_left(state, sweeps, times, under_way, now) if told and left else None
    return Progress(
        done=sum(sweep.state in _RECORDED for sweep in sweeps),
        total=len(sweeps),
        remaining=remaining if left else 0.0,
        repeat=_pace(sweeps, times) * _sum(sweeps, times, _AGAIN) if told else 0.0,
        current=next((sweep for sweep in sweeps if sweep.state is SweepState.RUNNING), None),
    )


def _time_left(
    state: CampaignState,
    sweeps: Sequence[SweepDocument],
    times: Sequence[PlannedTime],
    under_way: UnderWay | None,
    now: float | None,
) -> float:
    """Of a campaign with sweeps left, s."""
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


def _sum(sweeps: Sequence[SweepDocument], times: Sequence[PlannedTime], states: Sequence[SweepState]) -> float:
    return sum(each.duration for sweep, each in zip(sweeps, times, strict=True) if sweep.state in states)


def _pace(sweeps: Sequence[SweepDocument], times: Sequence[PlannedTime]) -> float:
    """Time from sweep to sweep so far over the plan's; 1 before there are two. Where it was held does not count."""
    ways: list[tuple[float, float]] = []
    recorded = sorted(
        ((sweep, each) for sweep, each in zip(sweeps, times, strict=True) if sweep.state in _RECORDED),
        key=lambda pair: pair[0].spec.started_at,
    )
    for (before, planned_before), (after, planned) in pairwise(recorded):
        gap = planned.start - planned_before.start
        if after.number == before.number + 1 and gap > 0:
            ways.append((after.spec.started_at - before.spec.started_at, gap))
    if not ways:
        return 1.0
    usual = median(taken / gap for taken, gap in ways)
    counted = [(taken, gap) for taken, gap in ways if taken / gap <= _PAUSE * usual]
    return sum(taken for taken, _ in counted) / sum(gap for _, gap in counted)


def steps(under_way: UnderWay | None, check_move: CheckMove | None) -> tuple[StepView, ...]:
    """What moves now, first, and what follows it up to the end of the present sweep; () while nothing is known."""
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
