"""What a stop or a lost lease means for who uses the machine, and that neither waits for anything slow."""

import asyncio
import threading
from collections.abc import Awaitable, Callable, Sequence
from functools import partial

import pytest
from sqlalchemy.exc import OperationalError
from structlog.testing import capture_logs

from drivers.errors import DriveFault
from service.application import tell_own_stop
from service.errors import Conflict, NotFound, NotNow
from service.execution import sweep_executor
from service.execution.external_stops import watching
from service.store.documents import CampaignState, SweepState
from service.store.guards import LeaseLost, MachineLease, StopLatch
from service.store.people.audit import AuditStore
from service.store.people.keys import KeyStore
from service.store.people.writer import AuditWriter
from tests.unit.service.campaigns.conftest import LEASE_TIME, TIMEOUT, Bench, keeping, refusing, until

pytestmark = pytest.mark.slow

PATIENCE = 20.0  # s


class BetweenMotions:
    """Holds a campaign where its first sweep is over and nothing moves: its recording is being written."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.reached, self.go = threading.Event(), threading.Event()
        self._finish = sweep_executor.finish
        monkeypatch.setattr(sweep_executor, "finish", self._slow)

    def _slow(self, *args, **kwargs):
        self.reached.set()
        assert self.go.wait(TIMEOUT)
        return self._finish(*args, **kwargs)


class Ailing(MachineLease):
    """The database refuses it until `well`; `renewed` counts."""

    well, renewed = True, 0

    def renew(self) -> None:
        if not self.well:
            raise OperationalError("UPDATE", {}, Exception("disk I/O error"))
        super().renew()
        self.renewed += 1


class Lost(MachineLease):
    """Another service has taken it."""

    def renew(self) -> None:
        raise LeaseLost("another service has taken the machine")


async def test_a_campaign_between_two_motions_does_not_go_on_when_the_stop_is_reset(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    between = BetweenMotions(monkeypatch)
    await bench.start()
    await until(between.reached.is_set)
    stop = await bench.machine.stop("ada", "hand in the cell")
    moved = list(bench.drive.trace)
    await bench.machine.reset_stop("ada", [stop.id])
    between.go.set()
    await bench.over()
    assert set(bench.drive.trace[len(moved) :]) <= {"stop"}
    campaign = bench.now
    assert (campaign.state, campaign.cause) == (CampaignState.PAUSED, "stopped by ada: hand in the cell")
    assert bench.store.sweep(bench.campaign.id, 1).state is SweepState.RECORDED
    second = bench.store.sweep(bench.campaign.id, 2)
    assert (second.state, second.cause) == (SweepState.INTERRUPTED, "stopped by ada: hand in the cell")

    await bench.resume(repeat=True)  # a person's word, and it goes on
    assert (await bench.over()).state is CampaignState.MEASURED


async def test_a_stop_that_the_database_does_not_take_is_seen_and_released_once_it_is_stored(bench: Bench) -> None:
    await bench.machine.connect()
    with refusing(bench, "INSERT ON stop"):
        await bench.machine.stop("ada", "smoke")
        assert "stop" in bench.drive.trace
        held = bench.machine.latched
        assert held is not None
        assert (held.by, held.why, held.reset_by) == ("ada", "smoke", None)
        with pytest.raises(Conflict, match="stopped by ada: smoke"):
            bench.machine.check_may_move(bench.intention)
        with pytest.raises(NotNow, match="the machine stays stopped"):
            await bench.machine.reset_stop("berta", [held.id])
        assert bench.machine.latched == held
    for _ in range(2):  # the same request again
        (reset,) = await bench.machine.reset_stop("berta", [held.id])
        assert (reset.by, reset.reset_by) == ("ada", "berta")
        assert bench.machine.latched is None
        bench.machine.check_may_move(bench.intention)
    with pytest.raises(NotFound, match=f"stop {held.id - 1}"):
        await bench.machine.reset_stop("berta", [held.id - 1])


async def test_what_the_database_did_not_take_is_noted_once_it_does(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("service.execution.state.latched_stops.AGAIN", 0.02)
    await bench.machine.connect()
    with refusing(bench, "INSERT ON stop"), capture_logs() as logs:
        told = [await bench.machine.stop(by, "smoke") for by in ("ada", "berta")]
        await until(lambda: any(log["event"] == "stop_not_noted_yet" for log in logs))
    await bench.machine.noted()
    stored = StopLatch(bench.database).latched()
    assert stored == bench.machine.stops
    assert [(stop.by, stop.at) for stop in stored] == [(stop.by, stop.at) for stop in told]
    await bench.machine.reset_stop("carl", [told[0].id])
    assert [stop.by for stop in StopLatch(bench.database).latched()] == ["berta"]
    await bench.machine.reset_stop("carl", [told[1].id, stored[1].id])
    assert bench.machine.latched is None


async def test_the_end_of_the_service_asks_the_database_once_more(bench: Bench) -> None:
    await bench.machine.connect()
    with refusing(bench, "INSERT ON stop"), capture_logs() as logs:
        await bench.machine.stop("ada", "smoke")
        await asyncio.wait_for(bench.machine.close(), PATIENCE)
    assert [log["by"] for log in logs if log["event"] == "stop_not_noted"] == ["ada"]


async def by_host_watch(bench: Bench) -> None:
    assert bench.drive.tell is not None
    bench.drive.tell("another host is there")
    await until(lambda: bool(bench.machine.stops))


async def by_a_locked_database(bench: Bench) -> None:
    """While it is locked, the audit cannot be written either."""
    lease = Ailing(bench.database, LEASE_TIME)
    lease.acquire()
    async with keeping(bench, lease):
        with bench.database.write() as session:
            session.connection()  # the only writer's place is taken
            await until(lambda: bench.machine.held != "")
        await until(lambda: bench.machine.held == "")


async def by_a_lost_lease(bench: Bench) -> None:
    await bench.machine.keep_lease(Lost(bench.database, LEASE_TIME), LEASE_TIME)


async def by_a_fault(bench: Bench) -> None:
    bench.drive.fail[1] = DriveFault("joint_1: over-current")
    await bench.start()
    await bench.over()


@pytest.mark.parametrize(
    ("cause", "way", "why"),
    [
        (by_host_watch, "host watch", "another host is there"),
        (by_a_locked_database, "lease", "the machine's lease could not be renewed: "),
        (by_a_lost_lease, "lease", "another service has taken the machine; restart this service"),
        (by_a_fault, "campaign 1", "DriveFault: joint_1: over-current"),
    ],
)
async def test_what_stops_the_machine_by_itself_is_in_the_audit(
    bench: Bench, cause: Callable[[Bench], Awaitable[None]], way: str, why: str
) -> None:
    await bench.machine.connect()
    store = AuditStore(bench.database)
    with AuditWriter(store, KeyStore(bench.database)) as audit:
        tell = partial(tell_own_stop, audit)
        bench.tell = tell
        async with watching(bench.machine, tell):
            await cause(bench)
        await bench.machine.noted()
    (entry,) = (one.entry for one in store.documents())
    assert (entry["event"], entry["way"], entry["actor"], entry["by"]) == ("stop", way, way, way)
    assert str(entry["why"]).startswith(why)


async def test_a_stop_that_comes_while_another_is_being_reset_holds(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    await bench.machine.connect()
    stop = await bench.machine.stop("ada", "smoke")
    resetting, go, reset = threading.Event(), threading.Event(), StopLatch.reset

    def slow(latch: StopLatch, by: str, stops: Sequence[int]):
        resetting.set()
        assert go.wait(TIMEOUT)
        return reset(latch, by, stops)

    monkeypatch.setattr(StopLatch, "reset", slow)
    first = asyncio.create_task(bench.machine.reset_stop("ada", [stop.id]))
    await until(resetting.is_set)
    second = asyncio.create_task(bench.machine.stop("berta", "fire"))
    await until(lambda: bench.drive.trace.count("stop") == 2)
    go.set()
    await first
    with pytest.raises(Conflict, match="stopped by berta: fire"):
        bench.machine.check_may_move(bench.intention)
    await second
    assert bench.machine.latched is not None
    assert bench.machine.latched.by == "berta"


async def test_neither_stop_nor_lease_waits_while_all_shared_threads_are_busy(bench: Bench) -> None:
    await bench.machine.connect()
    lease, go = Ailing(bench.database, LEASE_TIME), threading.Event()
    lease.acquire()
    busy = [asyncio.get_running_loop().run_in_executor(None, go.wait, TIMEOUT) for _ in range(100)]
    try:
        async with keeping(bench, lease):
            stop = await asyncio.wait_for(bench.machine.stop("ada", "smoke"), PATIENCE)
            await asyncio.wait_for(bench.machine.reset_stop("ada", [stop.id]), PATIENCE)
            await until(lambda: lease.renewed > 0)
    finally:
        go.set()
        await asyncio.gather(*busy)
