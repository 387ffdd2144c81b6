"""A campaign that was started with a sign of life ends at standstill when none comes, and only then."""

import asyncio

import pytest

from drivers.errors import Cause
from service.machine.execution.permission import SignOfLife
from service.model.errors import Conflict
from service.store.documents import CampaignState, SweepState
from tests.unit.service.campaigns.conftest import Bench, until, until_cancelled
from tests.unit.service.campaigns.test_machine import BetweenMotions

SOON, LATE = 0.05, 3600.0  # s


async def test_without_a_sign_of_life_it_is_paused_at_standstill(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    between = BetweenMotions(monkeypatch)
    await bench.start(attended=LATE)
    await until(between.reached.is_set)
    attendance = bench.runner.attendance
    assert attendance is not None
    attendance.within = SOON  # whatever the computer takes to come here, it is missed from here on
    attendance.renew()
    await until(lambda: attendance.left == 0.0)
    await until_cancelled(bench.campaign.id)
    between.go.set()
    campaign = await bench.over()
    assert campaign.state is CampaignState.PAUSED
    assert campaign.cause.startswith("no sign of life within 0.05 s")
    assert bench.machine.stops == ()  # nothing is latched: the next start is a person's
    assert bench.drive.trace[-1] == "stop"
    assert bench.told == [(f"campaign {campaign.id}", campaign.cause)]

    await bench.resume(repeat=True)
    assert (await bench.over()).state is CampaignState.MEASURED


async def test_with_signs_of_life_it_is_measured(bench: Bench) -> None:
    with pytest.raises(Conflict, match="is not running"):
        bench.runner.sign_of_life(bench.campaign.id)
    await bench.start(attended=LATE)
    attendance = bench.runner.sign_of_life(bench.campaign.id)
    assert attendance is not None
    assert attendance.left <= attendance.within == LATE
    assert (await bench.over()).state is CampaignState.MEASURED
    assert all(sweep.state is SweepState.RECORDED for sweep in bench.store.sweeps(bench.campaign.id))
    assert bench.runner.attendance is None


@pytest.mark.parametrize(("first", "second", "kept"), [(None, 60.0, 60.0), (LATE, None, LATE), (LATE, 60.0, 60.0)])
async def test_a_pause_that_is_taken_back_keeps_the_sign_of_life_or_takes_that_of_the_resume(
    bench: Bench, first: float | None, second: float | None, kept: float
) -> None:
    await bench.in_a_sweep(2, attended=first)
    await bench.runner.pause(bench.campaign.id)
    resumed = await bench.resume(attended=second)
    assert resumed.state is CampaignState.RUNNING
    attendance = bench.runner.attendance
    assert attendance is not None
    assert attendance.within == kept
    attendance.within = SOON
    attendance.renew()
    await bench.over()  # the sweep is held for ever: nothing else ends it
    campaign = bench.now
    assert campaign.state is CampaignState.PAUSED
    assert campaign.cause.startswith("no sign of life within 0.05 s")
    assert bench.drive.energised == set()


async def test_who_wants_none_waits_for_none(bench: Bench) -> None:
    await bench.start()
    assert bench.runner.sign_of_life(bench.campaign.id) is None
    assert (await bench.over()).state is CampaignState.MEASURED


async def test_each_sign_of_life_sets_the_time_anew_and_the_end_ends_it() -> None:
    missed: list[Cause] = []
    ended, waiting = SignOfLife(SOON, missed.append), SignOfLife(LATE, missed.append)
    ended.end()
    before = asyncio.get_running_loop().time()
    waiting.renew()
    assert waiting.left >= LATE - (asyncio.get_running_loop().time() - before) - 1e-3
    waiting.end()
    overdue = SignOfLife(SOON, missed.append)
    await until(lambda: bool(missed))  # the last one: `ended` was due before
    assert len(missed) == 1
    assert overdue.left == 0.0
