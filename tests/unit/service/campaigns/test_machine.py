"""The lease kept and lost in front of a formula machine."""

import asyncio

from service.store.documents import CampaignState, SweepState
from service.store.guards import MachineLease
from tests.unit.service.campaigns.conftest import TIMEOUT, Bench, until

LEASE_TIME = 0.5  # s


async def test_who_loses_the_lease_stops_and_moves_no_more(bench: Bench) -> None:
    mine, other = MachineLease(bench.database, LEASE_TIME), MachineLease(bench.database, LEASE_TIME)
    mine.acquire()
    bench.drive.hold = 2
    await bench.runner.start(bench.campaign.id)
    await asyncio.wait_for(bench.drive.holding.wait(), TIMEOUT)
    await asyncio.to_thread(other.acquire)  # this service was silent: nobody renewed
    await asyncio.wait_for(bench.machine.keep_lease(mine, LEASE_TIME), TIMEOUT)
    await asyncio.wait_for(bench.runner.finished(), TIMEOUT)
    campaign = bench.store.campaign(bench.campaign.id)
    assert (campaign.state, campaign.cause) == (
        CampaignState.PAUSED,
        "another service has taken the machine; restart this one",
    )
    assert campaign.sweeps[SweepState.INTERRUPTED] == 1
    assert bench.drive.energised == set()
    other.renew()


async def test_a_database_that_does_not_answer_stops_the_machine_until_it_does(bench: Bench) -> None:
    lease = MachineLease(bench.database, LEASE_TIME)
    lease.acquire()
    keeper = asyncio.create_task(bench.machine.keep_lease(lease, LEASE_TIME))
    with bench.database.write() as session:
        session.connection()  # begins: the only writer's place is taken
        await until(lambda: bench.machine.held != "")
        assert "stop" in bench.drive.trace
        assert "could not be renewed" in bench.machine.held
    await until(lambda: bench.machine.held == "")
    keeper.cancel()
    await asyncio.wait([keeper])
