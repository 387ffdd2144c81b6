"""A stop, a gap of the host or trouble with the lease ends what was wanted before it, whatever it waited for."""

import asyncio
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any

import pytest

from drivers.errors import Cause, CauseCode
from service import Superseded
from service.machine.execution.energising import Approvals, Epochs, Intention
from service.machine.execution.machine import watching
from service.store.documents import CampaignState
from service.store.lease_and_latch import ApprovalStore
from tests.unit.service.campaigns.conftest import TIMEOUT, Barrier, Bench, keeping, until
from tests.unit.service.campaigns.test_approvals import HASH, Asked
from tests.unit.service.campaigns.test_experiments import Loop, attended, followed, loop  # noqa: F401
from tests.unit.service.campaigns.test_machine import Ailing

pytestmark = pytest.mark.slow

LEASE_TIME = 0.05  # s


# what a command waits for
WAITS: dict[str, Callable[[Bench], tuple[object, str]]] = {
    "connection": lambda bench: (bench.drive, "connect"),
    "compilation": lambda bench: (bench, "compile_plan"),
    "approval": lambda _: (Approvals, "check"),
    "database": lambda bench: (bench.store, "move_campaign"),
    "another command": lambda bench: (bench.store, "own_campaign"),  # which itself waits for the database
    "sweep to begin": lambda bench: (bench.store, "begin_sweep"),
    "check move": lambda bench: (bench.store, "add_check_move"),
}


# -- what comes in between ------------------------------------------------------------------------------------------


async def stop_and_release(bench: Bench) -> str:
    stop = await bench.machine.stop("ada", "hand in the cell")
    await bench.machine.reset_stop("ada", [stop.id])
    return "stopped by ada: hand in the cell"


async def gap_and_release(bench: Bench) -> str:
    async with watching(bench.machine, lambda _by, _why: None):
        assert bench.drive.tell is not None
        gap = Cause(CauseCode.HOST_GAP, detail="the host was suspended for 8.0 s")
        await asyncio.to_thread(bench.drive.tell, gap)
        (stop,) = bench.machine.stops
    await bench.machine.noted()
    await bench.machine.reset_stop("ada", [each.id for each in bench.machine.stops])
    return f"stopped by {stop.by}: the host was suspended for 8.0 s"


async def lease_trouble(bench: Bench) -> str:
    lease = Ailing(bench.database, LEASE_TIME)
    lease.acquire()
    lease.well = False
    async with keeping(bench, lease, LEASE_TIME):
        await until(lambda: bench.machine.forbidden != "")
        lease.well = True
        await until(lambda: bench.machine.forbidden == "")
    return "the machine's lease could not be renewed"


# -- who wants to move ----------------------------------------------------------------------------------------------

Command = Callable[[Loop], Coroutine[Any, Any, object]]


async def start(bed: Loop) -> object:
    return await bed.bench.start()


async def resume(bed: Loop) -> object:
    return await bed.bench.runner.resume(bed.bench.store.campaigns()[-1].id, bed.bench.intention, repeat=True)


async def experiment(bed: Loop) -> object:
    (proposed,) = bed.diagnoses.diagnoses()
    return await bed.experiments.approve(proposed.id, "joint_1", "Ada", None, "workshop", bed.bench.intention)


def energy(bench: Bench) -> list[str]:
    return [entry for entry in bench.drive.trace if entry.startswith("enable")]


COMMANDS, BETWEEN = (start, resume, experiment), (stop_and_release, gap_and_release, lease_trouble)


@pytest.mark.parametrize(  # each pair of the three
    ("command", "wait", "between"),
    [(COMMANDS[k], wait, BETWEEN[(k + n) % 3]) for k in range(3) for n, wait in enumerate(WAITS)],
)
async def test_nothing_moves_that_was_wanted_before_a_stop(
    loop: Loop,  # noqa: F811
    command: Command,
    wait: str,
    between: Callable[[Bench], Awaitable[str]],
    barrier: Barrier,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bench = loop.bench
    if command is resume:
        bench.store.move_campaign(bench.campaign.id, lambda _: CampaignState.PAUSED)
    if command is experiment:
        loop.done("reversal", sweeps=True)
    if wait != "connection":
        await bench.machine.connect()
    barrier.before(monkeypatch, *WAITS[wait](bench))
    if wait == "another command":
        refused = asyncio.create_task(bench.runner.abort(bench.campaign.id, "by an old page", if_version=99))
        refused.add_done_callback(lambda task: task.exception())
    waiting = asyncio.create_task(command(loop))
    await until(barrier.reached.is_set)
    reason = await between(bench)
    barrier.opened.set()
    if wait in ("sweep to begin", "check move"):  # it was answered before; the campaign ends
        await waiting
        await bench.over()
        stopped = bench.store.campaigns()[-1]
        assert stopped.state is CampaignState.PAUSED
        assert reason in stopped.cause
    else:
        with pytest.raises(Superseded, match=f"after the command was given: {reason}.* give the command again"):
            await waiting
        assert bench.runner.running is None
        assert all(one.state is not CampaignState.RUNNING for one in bench.store.campaigns())
    assert energy(bench) == []

    bench.drive.hold = 0
    await (resume if bench.store.campaigns()[-1].state is CampaignState.PAUSED else command)(loop)
    await asyncio.wait_for(bench.drive.holding.wait(), TIMEOUT)
    assert energy(bench) != []  # it was the epoch, and nothing else
    await bench.machine.stop("ada", "enough seen")
    await bench.over()


async def test_an_approval_that_waits_for_the_database_is_not_stored(
    bench: Bench, barrier: Barrier, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked, plan = Asked(bench), bench.campaign.plan_id or 0
    intention = bench.intention
    barrier.before(monkeypatch, ApprovalStore, "add")

    def approve(given: Intention) -> object:
        return asked.approvals.add(plan, HASH, HASH, "ada", lambda: bench.machine.epochs.check(given))

    waiting = asyncio.create_task(asyncio.to_thread(approve, intention))
    await until(barrier.reached.is_set)
    reason = await stop_and_release(bench)
    barrier.opened.set()
    with pytest.raises(Superseded, match=reason):
        await waiting
    assert asked.approvals.of_plan(plan) == ()
    await asyncio.to_thread(approve, bench.intention)
    assert len(asked.approvals.of_plan(plan)) == 1
    asked.close()


async def test_a_pause_is_not_taken_back_by_what_was_wanted_before_a_stop(bench: Bench) -> None:
    await bench.in_a_sweep()
    await bench.runner.pause(bench.campaign.id)
    older = bench.intention
    bench.machine.epochs.begin(Cause(CauseCode.STOPPED, by="ada", detail="smoke"))
    with pytest.raises(Superseded, match="stopped by ada: smoke"):
        await bench.runner.resume(bench.campaign.id, older)
    assert bench.now.state is CampaignState.PAUSING
    await bench.runner.close()


async def test_an_unattended_experiment_is_as_old_as_the_request_of_its_diagnosis(loop: Loop) -> None:  # noqa: F811
    found = loop.done("reversal", sweeps=True)  # as one requested now
    await loop.bench.machine.connect()
    reason = await stop_and_release(loop.bench)
    async with followed(loop, 0):  # it is heard only now that it is done
        ended = await attended(loop, found.id)
    assert (ended.unattended, ended.experiment) == (False, None)
    assert reason in ended.cause
    assert energy(loop.bench) == []


def test_only_the_present_epoch_is_good_and_a_release_begins_none() -> None:
    epochs, others = Epochs(), Epochs()
    first = Intention(epochs.now)
    epochs.check(first)
    with pytest.raises(Superseded, match="this service was started"):
        others.check(first)
    epochs.begin(Cause(CauseCode.STOPPED, by="ada", detail="smoke"))
    epochs.begin(Cause(CauseCode.STOPPED, by="berta", detail="fire"))
    second = Intention(epochs.now)
    epochs.check(second)
    assert str(epochs.since(first)) == "stopped by ada: smoke"  # the first that came
    with pytest.raises(Superseded, match="stopped by ada: smoke"):
        epochs.check(first)
    for forged in ("", "-", "1", f"{first.epoch}9", first.epoch.replace("-0", "-x"), first.epoch.replace("-0", "-²")):
        assert epochs.since(Intention(forged)), forged


def test_the_epoch_that_a_person_saw_counts_and_none_that_is_to_come() -> None:
    epochs = Epochs()
    seen = epochs.now
    assert epochs.given(None) == epochs.given(seen) == seen
    to_come = seen.removesuffix("0") + "1"
    assert epochs.given(to_come) == ""
    epochs.begin(Cause(CauseCode.STOPPED, by="ada", detail="smoke"))
    assert epochs.now == to_come
    assert epochs.given(seen) == seen
    assert epochs.given("of another service") == ""
    assert str(epochs.since(Intention(epochs.given(seen)))) == "stopped by ada: smoke"
