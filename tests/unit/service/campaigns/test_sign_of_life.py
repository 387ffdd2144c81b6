"""A campaign that was started with a sign of life ends at standstill when none comes, and only then."""

import asyncio

import pytest

from service.errors import Conflict
from service.execution.sign_of_life import SignOfLife
from service.store.documents import CampaignState, SweepState
from tests.unit.service.campaigns.conftest import TIMEOUT, Bench, until, until_cancelled
from tests.unit.service.campaigns.test_machine_held import BetweenMotions

SOON, LATE = 0.05, 3600.0  # s


async def test_without_a_sign_of_life_it_is_paused_at_standstill(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    between = BetweenMotions(monkeypatch)
    await bench.runner.start(bench.campaign.id, attended=LATE)
    await until(between.reached.is_set)
    attendance = bench.runner.attendance
    assert attendance is not None
    attendance.within = SOON  # whatever the computer takes to come here, it is missed from here on
    attendance.renew()
    await until(lambda: attendance.left == 0.0)
    await until_cancelled(bench.campaign.id)
    between.go.set()
    await asyncio.wait_for(bench.runner.finished(), TIMEOUT)
    campaign = bench.store.campaign(bench.campaign.id)
    assert campaign.state is CampaignState.PAUSED
    assert campaign.cause.startswith("no sign of life within 0.05 s")
    assert bench.machine.stops == ()  # nothing is latched: the next start is a person's
    assert bench.drive.trace[-1] == "stop"
    assert bench.told == [(f"campaign {campaign.id}", campaign.cause)]

    await bench.runner.resume(bench.campaign.id, repeat=True)
    await asyncio.wait_for(bench.runner.finished(), TIMEOUT)
    assert bench.store.campaign(bench.campaign.id).state is CampaignState.MEASURED


async def test_with_signs_of_life_it_is_measured(bench: Bench) -> None:
    with pytest.raises(Conflict, match="is not running"):
        bench.runner.sign_of_life(bench.campaign.id)
    await bench.runner.start(bench.campaign.id, attended=LATE)
    attendance = bench.runner.sign_of_life(bench.campaign.id)
    assert attendance is not None
    assert attendance.left <= attendance.within == LATE
    await asyncio.wait_for(bench.runner.finished(), TIMEOUT)
    assert bench.store.campaign(bench.campaign.id).state is CampaignState.MEASURED
    assert all(sweep.state is SweepState.RECORDED for sweep in bench.store.sweeps(bench.campaign.id))
    assert bench.runner.attendance is None


async def test_who_wants_none_waits_for_none(bench: Bench) -> None:
    await bench.runner.start(bench.campaign.id)
    assert bench.runner.sign_of_life(bench.campaign.id) is None
    await asyncio.wait_for(bench.runner.finished(), TIMEOUT)
    assert bench.store.campaign(bench.campaign.id).state is CampaignState.MEASURED


async def test_each_sign_of_life_sets_the_time_anew_and_the_end_ends_it() -> None:
    missed: list[str] = []
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
