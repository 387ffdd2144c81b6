"""Remaining time of a campaign, and what moves now."""

import math
from datetime import UTC, datetime

import pytest
from pydantic import JsonValue

from service.machine.execution.check_move import CheckMove
from service.machine.execution.sweep_executor import CurrentActivity, travels
from service.planning.campaigns.stored_plan import PlannedTime, planned_times
from service.store.documents import CampaignState, PlanRecord, SweepState, SweepStatus
from service.web.api.campaigns import CHECK_MOVE, expected_time, progress, steps

PLANNED, RUNNING = SweepState.PLANNED, SweepState.RUNNING
TIMES = (30.0, 12.0, 20.0, 12.0, 40.0, 12.0, 16.0, 12.0)  # s, as planned: long ways and short ones


def sweep(number: int, state: SweepState, started_at: float = 0.0) -> SweepStatus:
    return SweepStatus(number, state, 0 if state is PLANNED else 1, started_at)


def plan(durations: tuple[float, ...] = TIMES) -> tuple[PlannedTime, ...]:
    """Each sweep proper takes 8 s, what remains of its time is the way to it."""
    ends = [sum(durations[: number + 1]) for number in range(len(durations))]
    sweeps: list[JsonValue] = [
        {"duration": took, "spec": {"axis": "joint_1", "started_at": end - 8.0}, "legs": [{"joint": "joint_2"}]}
        for took, end in zip(durations, ends, strict=True)
    ]
    now = datetime(2026, 11, 23, tzinfo=UTC)
    return planned_times(PlanRecord(id=1, robot_id=1, document={"sweeps": sweeps}, created_at=now))


def under_way(
    number: int, begun: float, checked: frozenset[str] = frozenset({"joint_1", "joint_2"})
) -> CurrentActivity:
    return CurrentActivity((number,), ("joint_1",), (), 8.0, checked, begun)


def test_before_the_start_the_plan_counts_with_its_moves_and_the_check_moves() -> None:
    found = progress(CampaignState.PLANNED, [sweep(n + 1, PLANNED) for n in range(len(TIMES))], plan())
    assert (found.done, found.total, found.current) == (0, len(TIMES), None)
    assert found.remaining == pytest.approx(sum(TIMES) + 2 * CHECK_MOVE)
    assert expected_time(plan()) == found.remaining  # what the plan's own page says


@pytest.mark.slow
@pytest.mark.parametrize(("pace", "extra"), [(1.0, 0.0), (1.3, 0.0), (1.0, 2.1), (0.05, 0.1)])
def test_after_the_first_quarter_it_is_right_within_a_tenth(pace: float, extra: float) -> None:
    """Whether the machine is slower than planned, needs time around each sweep, or is simulated faster than time."""
    durations = TIMES * 4
    really = [pace * took + extra for took in durations]
    starts = [sum(really[: n + 1]) - pace * 8.0 for n in range(len(really))]
    for done in range(len(really) // 4, len(really)):
        sweeps = [sweep(n + 1, SweepState.IDENTIFIED, starts[n]) for n in range(done)]
        sweeps += [sweep(done + 1, RUNNING), *(sweep(n + 1, PLANNED) for n in range(done + 1, len(really)))]
        begun = sum(really[:done])
        for part in (0.0, 0.5):
            now = begun + part * really[done]
            found = progress(CampaignState.RUNNING, sweeps, plan(durations), under_way(done + 1, begun), now)
            assert found.remaining == pytest.approx(sum(really) - now, rel=0.1, abs=0.1 * really[-1])


def test_a_pause_does_not_slow_the_pace() -> None:
    starts = (4.0, 16.0, 28.0, 1028.0, 1040.0)  # every 12 s, one pause
    sweeps = [sweep(n, SweepState.IDENTIFIED, start) for n, start in enumerate(starts, 1)]
    sweeps += [sweep(6, RUNNING), sweep(7, PLANNED)]
    found = progress(CampaignState.RUNNING, sweeps, plan((12.0,) * 7), under_way(6, 100.0), 106.0)
    assert (found.remaining, found.pace) == (pytest.approx(18.0), 1.0)


def test_what_is_left_of_a_held_of_a_finished_and_of_an_unplanned_campaign() -> None:
    sweeps = [sweep(1, SweepState.IDENTIFIED, 22.0), sweep(2, SweepState.INTERRUPTED), sweep(3, PLANNED)]
    held = progress(CampaignState.PAUSED, sweeps, plan((30.0, 12.0, 20.0)))
    assert (held.remaining, held.repeat) == (pytest.approx(20.0 + 2 * CHECK_MOVE), pytest.approx(12.0))
    sweeps = [sweep(1, SweepState.IDENTIFIED, 10.0), sweep(2, SweepState.FAILED)]  # a failed one is not done
    over = progress(CampaignState.COMPLETED, sweeps, plan((12.0, 12.0)))
    assert (over.done, over.total, over.remaining, over.repeat) == (1, 2, 0.0, 0.0)
    assert progress(CampaignState.PLANNED, [sweep(1, PLANNED)], ()).remaining is None


def test_the_axis_that_travels_comes_first_and_what_follows_after_it() -> None:
    way = travels(("joint_1", "joint_2"), (0.0, 0.1), ((1, -0.7), (0, 0.2)), 0.1)
    assert [(leg.joint, leg.target) for leg in way] == [("joint_2", -0.7), ("joint_1", 0.2)]
    assert [leg.seconds for leg in way] == [pytest.approx(8.0), pytest.approx(2.0)]
    now = CurrentActivity((3,), ("joint_1",), way, 12.0, frozenset(), 0.0)
    told = [(step.kind, step.axes, step.target) for step in steps(now, None, 1.0)]
    assert told == [("travel", ("joint_2",), -0.7), ("travel", ("joint_1",), 0.2), ("sweep", ("joint_1",), None)]
    check = CheckMove("joint_2", -math.radians(0.5), {"joint_2": 0.1}, {"joint_2": "rad"})
    assert [step.kind for step in steps(now, check, 1.0)] == ["check_move", "travel", "travel", "sweep"]
    assert steps(None, None, 1.0) == ()
    assert [step.seconds for step in steps(now, check, 0.125)] == pytest.approx([0.25, 1.0, 0.25, 1.5])
