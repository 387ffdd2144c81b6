"""The lease and the drives kept and lost, stops and releases that meet, in front of a formula machine; none waits for
anything slow.
"""

import asyncio
import threading
import time
from collections.abc import AsyncGenerator, Awaitable, Callable
from contextlib import asynccontextmanager
from functools import partial
from unittest.mock import Mock

import pytest
from sqlalchemy.exc import TimeoutError as PoolTimeout
from structlog.testing import capture_logs

from drivers.errors import Cause, CauseCode, CommunicationLost, DriveFault, StopNotConfirmed
from service import Conflict, EnvelopeViolation, NotFound, NotNow
from service.machine.execution import sweep_executor
from service.machine.execution.machine import watching
from service.machine.execution.stops import LatchedStops, StopSequences
from service.planning.safety.envelope_check import Envelope
from service.store.documents import CampaignState, SweepState
from service.store.lease_and_latch import LeaseLost, MachineLease, StopLatch
from service.store.people.audit import AuditStore, AuditWriter
from service.store.people.users import KeyStore
from service.web.application import tell_own_stop
from tests.unit.service.campaigns.conftest import LEASE_TIME, TIMEOUT, Barrier, Bench, command, keeping, refusing, until

pytestmark = pytest.mark.slow


async def test_who_loses_the_lease_stops_leaves_the_bus_and_does_not_come_back(bench: Bench) -> None:
    mine, other = MachineLease(bench.database, LEASE_TIME), MachineLease(bench.database, LEASE_TIME)
    mine.acquire()
    await bench.in_a_sweep()
    await asyncio.to_thread(other.acquire)  # this service was silent: nobody renewed
    await asyncio.wait_for(bench.machine.keep_lease(mine, LEASE_TIME), TIMEOUT)
    campaign = await bench.over()
    taken = "another service has taken the machine; restart this service"
    assert (campaign.state, campaign.cause) == (CampaignState.PAUSED, taken)
    assert campaign.sweeps[SweepState.INTERRUPTED] == 1
    other.renew()
    await until(lambda: "close" in bench.drive.trace[2:])
    assert not bench.machine.connected
    moved = list(bench.drive.trace)
    for refused in (bench.machine.connect, bench.resume):
        with pytest.raises(Conflict, match="another service has taken the machine"):
            await refused()
    assert bench.drive.trace == moved


async def test_a_watch_over_the_lease_that_breaks_off_stops_the_machine(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(MachineLease, "renew", Mock(side_effect=ArithmeticError("unforeseen")))
    with pytest.raises(ArithmeticError):
        await bench.machine.keep_lease(MachineLease(bench.database, LEASE_TIME), LEASE_TIME)
    assert "stop" in bench.drive.trace
    assert "unforeseen" in bench.machine.held
    with pytest.raises(Conflict, match="may not move"):
        bench.machine.check_may_move(bench.intention)


async def test_a_release_frees_neither_a_stop_under_way_nor_one_of_another(bench: Bench) -> None:
    anna = await bench.machine.stop("anna", "smoke")
    pressed, go, stop = asyncio.Event(), asyncio.Event(), bench.drive.stop

    async def slow() -> tuple[str, ...]:
        pressed.set()
        await go.wait()
        return await stop()

    bench.drive.stop = slow
    second = asyncio.create_task(bench.machine.stop("berta", "hose caught"))
    await pressed.wait()
    bench.drive.stop = stop
    carl = await bench.machine.stop("carl", "smoke again")  # over sooner than the one before
    await bench.machine.noted()
    (under_way,) = (stop.id for stop in bench.machine.stops if stop.by == "berta")
    with pytest.raises(Conflict, match=f"stop {under_way} is not finished yet: berta: hose caught"):
        await bench.machine.reset_stop("anna", [anna.id, under_way])
    for _ in range(2):  # the same request again
        await bench.machine.reset_stop("anna", [anna.id])
        assert bench.machine.held == "stopped by berta: hose caught"
    go.set()
    berta = await second
    assert [stop.by for stop in bench.machine.stops] == ["berta", "carl"]
    await bench.machine.reset_stop("anna", [berta.id])
    assert bench.machine.held == "stopped by carl: smoke again"
    await bench.machine.reset_stop("anna", [carl.id])
    assert bench.machine.held == ""
    with pytest.raises(NotFound):
        await bench.machine.reset_stop("anna", [berta.id + 1000])


async def test_one_press_that_comes_by_two_ways_is_one_stop(bench: Bench) -> None:
    hold = bench.machine.latch("anna", "smoke", "press 1")  # by the stop process
    await asyncio.gather(bench.machine.confirm(hold), bench.machine.stop("anna", "smoke", "press 1"))
    assert len(bench.machine.stops) == 1
    await bench.machine.stop("anna", "smoke", "press 2")
    assert len(bench.machine.stops) == 2


async def test_a_flood_of_stops_is_one_stop_of_its_source_and_delays_nobody(bench: Bench) -> None:
    halts: list[float] = []
    bench.drive.halt = lambda: halts.append(time.monotonic())
    begun = time.monotonic()
    flood = [bench.machine.latch("nobody", "flood", f"press {k}", "10.0.0.7 nobody") for k in range(1000)]
    confirming = [asyncio.create_task(bench.machine.confirm_logged(hold)) for hold in flood]
    stop = await bench.machine.stop("anna", "smoke", source="10.0.0.8 anna", within=60.0)  # a busy computer
    assert [each.by for each in bench.machine.stops] == ["nobody", "anna"]
    await asyncio.gather(*confirming)
    assert bench.drive.trace.count("stop") <= 3  # the drives go through few stop sequences
    assert len(halts) <= (time.monotonic() - begun) / StopSequences.halted + 2
    await bench.machine.reset_stop("anna", [each.id for each in bench.machine.stops])
    assert stop.by == "anna"
    again = await bench.machine.stop("nobody", "flood", source="10.0.0.7 nobody")  # released: it is a new stop
    assert [each.id for each in bench.machine.stops] == [again.id]


async def test_a_release_of_what_was_seen_does_not_release_its_repetition(bench: Bench) -> None:
    """Found by a random sequence in virtual time."""
    await bench.machine.stop("anna", "smoke", source="10.0.0.8 anna")
    await bench.machine.noted()
    seen = [stop.id for stop in bench.machine.stops]
    await bench.machine.stop("anna", "smoke", source="10.0.0.8 anna")
    with pytest.raises(Conflict, match="was repeated since it was seen: look at the machine, then release again"):
        await bench.machine.reset_stop("berta", seen)
    again = [stop.id for stop in bench.machine.stops]
    for _ in range(2):  # the same request again
        (released,) = await bench.machine.reset_stop("berta", again)
        assert (released.by, released.reset_by, bench.machine.held) == ("anna", "berta", "")
    assert StopLatch(bench.database).latched() == ()


async def test_a_flood_from_everywhere_keeps_a_bounded_number_of_stops(bench: Bench) -> None:
    for number in range(3 * LatchedStops.most):
        hold = bench.machine.latch(f"nobody {number}", "flood", "", f"10.0.0.7 nobody {number}")
        hold.under_way -= 1
    assert len(bench.machine.stops) == LatchedStops.most
    assert bench.machine.held.startswith("stopped by nobody 0")


async def test_a_stop_is_answered_in_time_whatever_the_drives_do_and_its_outcome_is_logged(bench: Bench) -> None:
    go = asyncio.Event()

    async def slow() -> tuple[str, ...]:
        await go.wait()
        raise StopNotConfirmed((), {"joint_1": "is silent"})

    bench.drive.stop = slow
    with capture_logs() as logs:
        with pytest.raises(StopNotConfirmed, match=r"joint_1: did not confirm it within 0\.05 s"):
            await bench.machine.stop("anna", "smoke", within=0.05)
        assert bench.machine.held == "stopped by anna: smoke"
        go.set()
        await bench.machine.close()
    assert [log["reason"] for log in logs if log["event"] == "stop_not_confirmed"] == ["joint_1: is silent"]


async def test_a_cabinet_that_was_switched_off_and_on_meanwhile_is_connected_before_it_moves(bench: Bench) -> None:
    await bench.machine.connect()
    bench.drive.silent = True
    await bench.start()
    await bench.over()
    assert [entry for entry in bench.drive.trace if entry != "standstill"][:5] == [
        "close", "connect", "close", "connect", "enable joint_1"
    ]  # fmt: skip


async def test_a_computer_that_comes_late_is_told_apart_from_a_database_that_does_not_answer(
    bench: Bench, barrier: Barrier, monkeypatch: pytest.MonkeyPatch
) -> None:
    barrier.before(monkeypatch, MachineLease, "renew")  # its answer does not come in time either
    lease = MachineLease(bench.database, LEASE_TIME)
    lease.acquire()
    async with keeping(bench, lease):
        await until(barrier.reached.is_set)
        asyncio.get_running_loop().call_soon(time.sleep, LEASE_TIME)  # something else has the processor
        await until(lambda: bench.machine.held != "")
        late = "the machine's lease could not be renewed: this computer was delayed by 0."
        assert bench.machine.held.startswith(late)
        assert "stop" in bench.drive.trace  # who is late may have lost the machine all the same
        barrier.opened.set()
        await until(lambda: bench.machine.held == "")


PATIENCE = 20.0  # s


@pytest.fixture
def between_motions(barrier: Barrier, monkeypatch: pytest.MonkeyPatch) -> Barrier:
    """Holds a campaign where its first sweep is over and nothing moves: its recording is being written."""
    barrier.before(monkeypatch, sweep_executor, "finish")
    return barrier


class Ailing(MachineLease):
    """No connection is free for it until `well`; `renewed` counts."""

    well, renewed = True, 0

    def renew(self) -> None:
        if not self.well:
            raise PoolTimeout("QueuePool limit of size 5 overflow 10 reached")
        super().renew()
        self.renewed += 1


async def test_a_campaign_between_two_motions_does_not_go_on_when_the_stop_is_reset(
    bench: Bench, between_motions: Barrier
) -> None:
    await bench.start()
    await until(between_motions.reached.is_set)
    stop = await bench.machine.stop("ada", "hand in the cell")
    moved = list(bench.drive.trace)
    await bench.machine.reset_stop("ada", [stop.id])
    between_motions.opened.set()
    campaign = await bench.over()
    assert set(bench.drive.trace[len(moved) :]) <= {"stop"}
    assert (campaign.state, campaign.cause) == (CampaignState.PAUSED, "stopped by ada: hand in the cell")
    first, second = bench.store.sweeps(bench.campaign.id)[:2]
    assert first.state is SweepState.RECORDED
    assert (second.state, second.cause) == (SweepState.INTERRUPTED, campaign.cause)

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


async def test_the_end_of_the_service_asks_the_database_once_more(bench: Bench) -> None:
    await bench.machine.connect()
    with refusing(bench, "INSERT ON stop"), capture_logs() as logs:
        await bench.machine.stop("ada", "smoke")
        await asyncio.wait_for(bench.machine.close(), PATIENCE)
    assert [log["by"] for log in logs if log["event"] == "stop_not_noted"] == ["ada"]


async def by_host_watch(bench: Bench) -> None:
    assert bench.drive.tell is not None
    bench.drive.tell(Cause(CauseCode.OTHER_HOST, detail="another host is there"))
    await until(lambda: bool(bench.machine.stops))


async def by_a_locked_database(bench: Bench) -> None:
    """While it is locked, the audit cannot be written either."""
    lease = Ailing(bench.database, LEASE_TIME)
    lease.acquire()
    async with keeping(bench, lease):
        with bench.database.write() as session:
            session.connection()  # the only writer's place is taken
            await until(lambda: bench.machine.held != "")
            assert "stop" in bench.drive.trace
        await until(lambda: bench.machine.held == "")


async def by_a_lost_lease(bench: Bench) -> None:
    lease = Mock(renew=Mock(side_effect=LeaseLost("another service has taken the machine")))
    await bench.machine.keep_lease(lease, LEASE_TIME)


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
    bench: Bench, barrier: Barrier, monkeypatch: pytest.MonkeyPatch
) -> None:
    await bench.machine.connect()
    stop = await bench.machine.stop("ada", "smoke")
    barrier.before(monkeypatch, StopLatch, "reset")
    first = asyncio.create_task(bench.machine.reset_stop("ada", [stop.id]))
    await until(barrier.reached.is_set)
    second = asyncio.create_task(bench.machine.stop("berta", "fire"))
    await until(lambda: bench.drive.trace.count("stop") == 2)
    barrier.opened.set()
    await first
    with pytest.raises(Conflict, match="stopped by berta: fire"):
        bench.machine.check_may_move(bench.intention)
    await second
    assert [each.by for each in bench.machine.stops] == ["berta"]


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


HOME = (0.0,) * 6


Go = Callable[[float], Awaitable[None]]


@pytest.fixture
async def connected(bench: Bench) -> Bench:
    await bench.machine.connect()
    bench.drive.trace.clear()
    return bench


@asynccontextmanager
async def reserved(bench: Bench, envelope: Envelope, target: float = 0.1) -> AsyncGenerator[Go]:
    """By somebody who has reserved the machine: joint_1 from home, as far as `target`."""
    with bench.machine.used_by("a test", bench.intention):
        async with (
            bench.machine.motion(envelope, bench.intention) as motion,
            motion.moving("joint_1", HOME, target, 0.05) as go,
        ):
            yield go


async def test_nobody_moves_a_machine_that_nobody_uses(connected: Bench, envelope: Envelope) -> None:
    with pytest.raises(Conflict, match="the machine is not reserved"):
        async with connected.machine.motion(envelope, connected.intention):
            pass
    assert connected.drive.trace == []


async def test_only_the_way_that_was_checked(connected: Bench, envelope: Envelope) -> None:
    with pytest.raises(Conflict, match=r"target 0\.2 is outside the checked range 0 to 0\.1"):
        async with reserved(connected, envelope) as go:
            await go(0.2)
    assert connected.drive.trace == ["enable joint_1", "stop"]
    assert connected.drive.energised == set()


async def test_what_the_envelope_forbids_gets_no_energy(connected: Bench, envelope: Envelope) -> None:
    with pytest.raises(EnvelopeViolation, match="joint_1: target"):
        async with reserved(connected, envelope, 99.0):
            pass
    with connected.machine.used_by("a test", connected.intention):
        far = command(connected.store.sweeps(connected.campaign.id)[0])
        with pytest.raises(EnvelopeViolation):
            async with (
                connected.machine.motion(envelope, connected.intention) as motion,
                motion.sweeping([far], (1.0, *HOME[1:])),
            ):
                pass
    assert "enable joint_1" not in connected.drive.trace


async def test_a_stop_is_asked_for_before_each_motion(connected: Bench, envelope: Envelope) -> None:
    async def move() -> None:
        async with reserved(connected, envelope) as go:
            await go(0.05)
            await connected.machine.stop("a person", "look")
            await go(0.1)

    with pytest.raises(Conflict, match="stopped by a person: look"):
        await move()
    assert connected.drive.trace == ["enable joint_1", "move joint_1 0.05", "stop", "stop"]


async def test_it_is_of_no_use_after_its_block(connected: Bench, envelope: Envelope) -> None:
    with connected.machine.used_by("a test", connected.intention):
        async with connected.machine.motion(envelope, connected.intention) as motion:
            pass
        with pytest.raises(Conflict, match="the permission to move has ended"):
            async with motion.moving("joint_1", HOME, 0.1, 0.05):
                pass
    assert connected.drive.trace == []


@pytest.mark.parametrize(
    "error", [CommunicationLost("bus-off"), KeyError("nobody thought of it"), asyncio.CancelledError()]
)
async def test_whatever_ends_it_leaves_every_axis_without_energy(
    connected: Bench, envelope: Envelope, error: BaseException
) -> None:
    connected.drive.stop_error = StopNotConfirmed([], {"joint_1": "mute"})

    async def move() -> None:
        async with reserved(connected, envelope):
            assert connected.drive.energised == {"joint_1"}
            raise error

    with pytest.raises(type(error)) as raised:
        await move()
    assert raised.value is error
    assert connected.drive.trace[-1] == "stop"
    assert connected.drive.energised == set()
    assert "the stop is not confirmed" in raised.value.__notes__[0]
    assert "the stop is not confirmed" in connected.machine.trouble


async def test_cancelled_while_it_is_brought_down_it_comes_down_all_the_same(
    connected: Bench, envelope: Envelope, monkeypatch: pytest.MonkeyPatch
) -> None:
    stopping, go_on, stop = asyncio.Event(), asyncio.Event(), connected.drive.stop

    async def slow() -> tuple[str, ...]:
        stopping.set()
        await go_on.wait()
        return await stop()

    monkeypatch.setattr(connected.drive, "stop", slow)

    async def move() -> None:
        async with reserved(connected, envelope):
            raise LookupError

    moving = asyncio.create_task(move())
    await stopping.wait()
    moving.cancel()
    await asyncio.sleep(0)
    assert not moving.done()
    go_on.set()
    await asyncio.wait([moving])
    assert moving.cancelled()
    assert connected.drive.energised == set()
