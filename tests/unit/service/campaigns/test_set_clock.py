"""A wall clock that is set while a campaign holds: no sweep begins before one that was measured, or before time 0."""

from datetime import timedelta
from pathlib import Path

import pytest

from service.model.robot import Robot
from service.planning.safety.envelope import Envelope
from service.store import tables as t
from service.store.documents import CampaignState
from tests.unit.service.campaigns.conftest import TIMEOUT, Bench, open_bench, until

pytestmark = pytest.mark.slow

SET_BY = (timedelta(hours=-1), timedelta(hours=1))


async def pause_in_the_second_sweep(bench: Bench) -> None:
    await bench.in_a_sweep()
    await bench.runner.pause(bench.campaign.id)
    bench.go_on()
    assert (await bench.over()).state is CampaignState.PAUSED


def set_clock(bench: Bench, by: timedelta) -> None:
    """As if it had been set by so much since the campaign was started."""
    with bench.database.write() as session:
        row = session.get_one(t.CampaignRow, bench.campaign.id)
        assert row.started_at is not None
        row.started_at -= by


async def go_on(bench: Bench) -> list[float]:
    """When the sweeps began."""
    await bench.resume()
    await bench.over()
    await until(lambda: bench.now.state is CampaignState.MEASURED)
    return [sweep.spec.started_at for sweep in bench.store.sweeps(bench.campaign.id)]


@pytest.mark.parametrize("by", SET_BY, ids=str)
async def test_a_service_that_goes_on_does_not_notice(bench: Bench, by: timedelta) -> None:
    await pause_in_the_second_sweep(bench)
    set_clock(bench, by)
    begun = await go_on(bench)
    assert begun == sorted(begun)
    assert 0 <= begun[0] <= begun[-1] < TIMEOUT


async def test_after_a_restart_nothing_begins_before_what_was_measured(
    tmp_path: Path, robot: Robot, envelope: Envelope
) -> None:
    async with open_bench(tmp_path, robot, envelope) as bench:
        await pause_in_the_second_sweep(bench)
        set_clock(bench, timedelta(hours=-1))
    async with open_bench(tmp_path, robot, envelope) as bench:
        begun = await go_on(bench)
    assert begun == sorted(begun)
    assert begun[0] >= 0
    assert begun[1] - begun[0] >= 6.3  # s, of the first sweep
