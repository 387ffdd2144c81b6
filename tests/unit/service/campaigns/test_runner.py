"""Campaigns in front of a formula machine: order, pause, abort, trouble, refusals, and a clock that is set."""

import asyncio
import dataclasses
import math
import os
import re
import threading
from collections.abc import Callable
from contextlib import AsyncExitStack
from datetime import timedelta
from functools import partial
from pathlib import Path
from typing import NamedTuple
from unittest.mock import Mock

import numpy as np
import pytest
from sqlalchemy.exc import SQLAlchemyError
from structlog.testing import capture_logs

from drivers.errors import CommunicationLost, DriveFault
from drivers.ports import SampleBlock, SweepCommand
from service import Conflict, EnvelopeViolation, NotFound
from service.machine.execution.runner import Runner
from service.model import Recording
from service.store import tables as t
from service.store.documents import CampaignDocument, CampaignState, RecordingState, SweepState
from service.store.files.columns import read_columns
from service.store.files.recordings import SweepAttempt
from service.store.store import StaleVersion
from tests.unit.service.campaigns.conftest import (
    RAMP,
    SETTLE,
    TIMEOUT,
    Again,
    Barrier,
    Bench,
    Taken,
    refusing,
    until,
    until_cancelled,
)

pytestmark = pytest.mark.slow


async def test_a_campaign_runs_to_its_end(bench: Bench) -> None:
    with bench.hub.subscribe(bench.campaign.id) as live:
        started = await bench.start()
        assert (started.state, bench.runner.running) == (CampaignState.RUNNING, bench.campaign.id)
        assert (await bench.over()).state is CampaignState.MEASURED
        bench.hub.close()
        finite = {(block.number, bool(np.isfinite(block.effort).all())) async for block in live}
    assert finite == {(1, True), (2, True), (3, True), (4, True)}
    sweeps = bench.store.sweeps(bench.campaign.id)
    assert [(s.state, s.attempt, s.cause) for s in sweeps] == [(SweepState.RECORDED, 1, "")] * 4
    begun = [s.spec.started_at for s in sweeps]
    assert begun == sorted(begun)
    assert begun[0] >= 0
    for sweep in sweeps:
        document = bench.store.recording(bench.campaign.id, sweep.number)
        assert document.state is RecordingState.COMPLETE
        recording = bench.files.load(document)
        assert len(recording.time) == document.samples == round(6.3 * 250)
        assert sweep.spec.measure_from == pytest.approx(1.0)
    assert bench.files.streams() == {}
    assert isinstance(bench.jobs, Taken)
    assert bench.jobs.sweeps == [1, 2, 3, 4]
    check_energy(bench.drive.trace)


def check_energy(trace: list[str]) -> None:
    """One axis has it at a time, and only to move. Each sweep starts where the last one ended: joint_1 goes back."""
    checked = ["enable joint_1", "move joint_1 0.00872665", "move joint_1 0", "disable joint_1"]
    sweep = ["enable joint_1", "sweep joint_1", "disable joint_1"]
    way = ["enable joint_1", "move joint_1 0.4", "disable joint_1"]
    assert [entry for entry in trace if entry != "standstill"][1:15] == ["connect", *checked, *sweep, *way, *sweep]
    energised: set[str] = set()
    for entry in trace:
        what, _, rest = entry.partition(" ")
        if what == "enable":
            assert energised == set()
            energised.add(rest)
        elif what in ("move", "sweep"):
            assert energised == {rest.split()[0]}
        elif what == "disable":
            energised.discard(rest)


async def test_what_the_disk_refused_is_stored_when_the_campaign_goes_on(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(path: Path, _: Recording) -> None:
        raise OSError(30, "Read-only file system", str(path))

    bench.drive.fail[3] = DriveFault("over-current")
    with monkeypatch.context() as read_only:
        read_only.setattr("service.store.files.columns.write_columns", refuse)
        await bench.start()
        await bench.over()
    assert "partial recording not written: [Errno 30] Read-only file system" in bench.store.sweep(1, 1).cause
    assert list(bench.files.streams()) == [SweepAttempt(1, 1, 1)]
    bench.drive.fail.clear()
    await bench.resume()
    await bench.over()
    partial = bench.store.recording(bench.campaign.id, 1)
    assert (partial.state, partial.samples) == (RecordingState.PARTIAL, 750)
    assert len(bench.files.load(partial).time) == 750
    assert bench.files.streams() == {}


async def test_a_pause_holds_after_the_present_sweep_unless_it_is_taken_back(bench: Bench) -> None:
    await bench.in_a_sweep()
    assert (await bench.runner.pause(bench.campaign.id)).state is CampaignState.PAUSING
    assert (await bench.resume()).state is CampaignState.RUNNING
    await bench.runner.pause(bench.campaign.id)
    bench.go_on()
    campaign = await bench.over()
    assert (campaign.state, campaign.cause) == (CampaignState.PAUSED, "paused by request")
    assert campaign.sweeps == {SweepState.RECORDED: 1, SweepState.PLANNED: 3}


async def test_a_resume_that_meets_the_pause_leaves_no_campaign_running_that_nothing_runs(bench: Bench) -> None:
    await bench.in_a_sweep()
    await bench.runner.pause(bench.campaign.id)
    campaign, asked, go = bench.store.own_campaign, threading.Event(), threading.Event()

    def slow(campaign_id):
        bench.store.own_campaign = campaign  # everybody else is answered at once
        asked.set()
        go.wait(TIMEOUT)
        return campaign(campaign_id)

    bench.store.own_campaign = slow
    refused = asyncio.create_task(bench.runner.abort(bench.campaign.id, "by an old page", if_version=1))
    await until(asked.is_set)
    resuming = asyncio.create_task(bench.resume())
    await asyncio.sleep(0)  # it waits for its turn, behind that command, while the campaign comes to its pause
    bench.go_on()
    await bench.over()
    go.set()
    with pytest.raises(StaleVersion):
        await refused
    with pytest.raises(Conflict, match="resume it again"):
        await resuming
    assert bench.now.state is CampaignState.PAUSED
    await bench.resume()
    assert (await bench.over()).state is CampaignState.MEASURED


async def test_abort_stops_the_sweep_and_skips_the_rest(bench: Bench) -> None:
    await bench.in_a_sweep()
    with pytest.raises(StaleVersion):
        await bench.runner.abort(bench.campaign.id, "enough", if_version=1)
    assert bench.runner.running == bench.campaign.id
    aborted = await bench.runner.abort(bench.campaign.id, "enough")
    assert (aborted.state, aborted.cause) == (CampaignState.ABORTED, "enough")
    assert aborted.sweeps == {SweepState.INTERRUPTED: 1, SweepState.SKIPPED: 3}
    assert bench.store.sweep(bench.campaign.id, 1).cause == "aborted: enough"
    assert bench.drive.energised == set()
    assert bench.store.recording(bench.campaign.id, 1).samples == 500


async def aborted_within(bench: Bench, barrier: Barrier) -> CampaignDocument:
    """Aborted while the store is where the barrier is."""
    await bench.start()
    await until(barrier.reached.is_set)
    aborting = asyncio.create_task(bench.runner.abort(bench.campaign.id, "enough"))
    await until_cancelled(bench.campaign.id)
    barrier.opened.set()
    return await aborting


async def test_an_abort_in_the_moment_in_which_a_sweep_begins_leaves_none_running(
    bench: Bench, barrier: Barrier, monkeypatch: pytest.MonkeyPatch
) -> None:
    barrier.before(monkeypatch, bench.store, "begin_sweep")
    aborted = await aborted_within(bench, barrier)
    assert aborted.sweeps == {SweepState.INTERRUPTED: 1, SweepState.SKIPPED: 3}
    assert not any(entry.startswith(("enable", "move", "sweep")) for entry in bench.drive.trace)


async def test_a_second_start_is_refused_while_one_runs(bench: Bench) -> None:
    await bench.in_a_sweep(0)
    assert bench.runner.sign_of_life(bench.campaign.id) is None  # who wants none waits for none
    for refused, told in (
        (bench.start, "campaign 1 is running"),
        (bench.machine.connect, "in use by campaign 1"),
        (partial(bench.machine.acknowledge, "joint_1"), "in use by campaign 1"),
    ):
        with pytest.raises(Conflict, match=told):
            await refused()
    bench.drive.go.set()
    await bench.over()


OVER_CURRENT = "DriveFault: joint_1: over-current"


@pytest.fixture
async def faulted(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> Bench:
    """A campaign in its first sweep, of which the next block is a fault of the drive."""
    monkeypatch.setattr(Runner, "retry", 0.05)
    bench.drive.hold, bench.drive.fail[3] = 2, DriveFault("joint_1: over-current")
    await bench.start()
    await asyncio.wait_for(bench.drive.holding.wait(), TIMEOUT)
    bench.drive.hold = None
    return bench


async def test_what_a_database_refuses_is_stored_as_soon_as_it_takes_it(
    faulted: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    attempts = list[str]()
    with refusing(faulted):
        with capture_logs() as logs:
            faulted.drive.go.set()
            await until(lambda: "end_not_stored" in [log["event"] for log in logs])
            sweeps_in = faulted.store.sweeps_in

            def attempt(*states):
                attempts.append("")
                return sweeps_in(*states)

            monkeypatch.setattr(faulted.store, "sweeps_in", attempt)
            await until(lambda: len(attempts) > 3)  # each begins so, and is not told
        assert [log["event"] for log in logs] == ["sweep_given_up", "sweep_not_ended", "end_not_stored"]
        assert "stop" in faulted.drive.trace
        assert faulted.store.campaign(1).sweeps[SweepState.RUNNING] == 1
    await faulted.over()
    campaign, sweep = faulted.store.campaign(1), faulted.store.sweep(1, 1)
    assert (campaign.state, campaign.cause) == (CampaignState.PAUSED, OVER_CURRENT)
    assert (sweep.state, sweep.cause) == (SweepState.INTERRUPTED, OVER_CURRENT)
    recording = faulted.store.recording(1, 1)
    assert (recording.state, recording.samples) == (RecordingState.PARTIAL, 750)
    assert faulted.files.streams() == {}
    faulted.drive.fail.clear()
    await faulted.resume(repeat=True)
    await faulted.over()
    assert faulted.store.campaign(1).sweeps == {SweepState.RECORDED: 4}


async def test_one_refusal_leaves_no_sweep_running(faulted: Bench) -> None:
    with refusing(faulted, "UPDATE ON sweep WHEN NEW.state = 'failed'"):
        faulted.drive.go.set()
        await faulted.over()
    assert faulted.store.campaign(1).sweeps == {SweepState.INTERRUPTED: 1, SweepState.PLANNED: 3}
    assert faulted.store.campaign(1).cause == OVER_CURRENT


REFUSED = {SweepState.INTERRUPTED: 1, SweepState.PLANNED: 3}


@pytest.mark.parametrize(
    ("command", "after"),
    [
        ("abort", {SweepState.INTERRUPTED: 1, SweepState.SKIPPED: 3}),
        ("start", REFUSED),
        ("pause", REFUSED),
        ("resume", {SweepState.RECORDED: 4}),
    ],
)
async def test_the_next_command_stores_what_was_refused(
    faulted: Bench, command: str, after: dict[SweepState, int]
) -> None:
    with refusing(faulted):
        with pytest.raises(SQLAlchemyError):
            await asyncio.wait_for(faulted.runner.abort(1, "enough"), TIMEOUT)
        assert (await faulted.over()).state is CampaignState.RUNNING
    faulted.drive.fail.clear()
    if command == "abort":
        assert (await faulted.runner.abort(1, "enough")).state is CampaignState.ABORTED
        assert faulted.store.sweep(1, 1).cause == "aborted: enough"
    elif command == "resume":
        await faulted.resume(repeat=True)
        await faulted.over()
    else:
        with pytest.raises(Conflict, match="is not possible in state paused"):
            await (faulted.start() if command == "start" else faulted.runner.pause(1))
    assert faulted.now.sweeps == after


async def test_the_service_ends_while_the_database_refuses(faulted: Bench) -> None:
    with refusing(faulted):
        faulted.drive.go.set()
        await until(lambda: "stop" in faulted.drive.trace)
        await asyncio.wait_for(faulted.runner.close(), TIMEOUT)
        assert faulted.runner.running is None


async def test_an_abort_while_the_end_of_a_sweep_is_stored_loses_no_result(
    bench: Bench, barrier: Barrier, monkeypatch: pytest.MonkeyPatch
) -> None:
    barrier.before(monkeypatch, bench.store, "end_sweep")
    aborted = await aborted_within(bench, barrier)
    assert aborted.sweeps == {SweepState.RECORDED: 1, SweepState.SKIPPED: 3}
    assert isinstance(bench.jobs, Taken)
    assert bench.jobs.sweeps == [1]
    causes = [event.data.get("cause") for event in bench.store.events(0) if event.kind.value == "campaign"]
    assert causes == ["", "", "aborted: enough", "enough"]
    assert bench.files.streams() == {}


@pytest.fixture
def disk(barrier: Barrier, monkeypatch: pytest.MonkeyPatch) -> Barrier:
    """One that takes nothing until it is opened."""
    barrier.before(monkeypatch, os, "fsync")
    return barrier


async def test_samples_are_watched_while_the_disk_stalls(
    bench: Bench, disk: Barrier, monkeypatch: pytest.MonkeyPatch
) -> None:
    measured(lambda block: block.velocity.__setitem__(1100, 0.5))(bench, monkeypatch)
    await bench.start()
    await until(disk.reached.is_set)
    await until(lambda: "stop" in bench.drive.trace)
    assert bench.drive.energised == set()
    disk.opened.set()
    await bench.over()
    sweep = bench.store.sweep(1, 1)
    assert sweep.state is SweepState.FAILED
    assert sweep.cause.startswith("EnvelopeViolation: joint_1: velocity 0.5 rad/s is outside")
    recording = read_columns(bench.files.path(bench.store.recording(1, 1)))
    assert (len(recording.time), float(recording.velocity.max())) == (1250, 0.5)


async def test_an_abort_while_the_disk_stalls_stops_the_drives_first(bench: Bench, disk: Barrier) -> None:
    await bench.in_a_sweep(3)
    await until(disk.reached.is_set)
    aborting = asyncio.create_task(bench.runner.abort(1, "enough"))
    await until(lambda: "stop" in bench.drive.trace)
    assert bench.drive.energised == set()
    disk.opened.set()
    await aborting
    assert bench.store.recording(1, 1).samples == 750


@pytest.mark.parametrize("restarted", [False, True])
@pytest.mark.parametrize("by", [timedelta(hours=-1), timedelta(hours=1)], ids=str)
async def test_sweeps_begin_in_their_order_whatever_sets_the_clock(
    again: Again, by: timedelta, restarted: bool
) -> None:
    """The clock is set by so much while the campaign is paused after its first sweep."""
    async with AsyncExitStack() as stack:
        bench = await stack.enter_async_context(again())
        await bench.in_a_sweep()
        await bench.runner.pause(bench.campaign.id)
        bench.go_on()
        assert (await bench.over()).state is CampaignState.PAUSED
        with bench.database.write() as session:
            row = session.get_one(t.CampaignRow, bench.campaign.id)
            assert row.started_at is not None
            row.started_at -= by
        if restarted:
            await stack.aclose()
            bench = await stack.enter_async_context(again())
        await bench.resume()
        assert (await bench.over()).state is CampaignState.MEASURED
        begun = [sweep.spec.started_at for sweep in bench.store.sweeps(bench.campaign.id)]
    assert begun == sorted(begun)
    assert begun[0] >= 0
    if restarted:
        assert begun[1] - begun[0] >= 6.3  # s, of the first sweep
    else:
        assert begun[-1] < TIMEOUT


WHOLE = round((5 * 1.0 + RAMP + SETTLE + RAMP) * 250)  # samples of a sweep


Make = Callable[[Bench, pytest.MonkeyPatch], None]


class Case(NamedTuple):
    """`cause`: a pattern. `kept`: samples of the partial recording, None: there is none. `moves`: some axis does."""

    make: Make
    cause: str
    kept: int | None = None
    sweep: int = 1
    moves: bool = True


def fails(block: int, error: Exception) -> Make:
    def make(bench: Bench, patch: pytest.MonkeyPatch) -> None:
        patch.setattr(bench.drive, "fail", {block: error})

    return make


def lost_sample(bench: Bench, patch: pytest.MonkeyPatch) -> None:
    patch.setattr(bench.drive, "skip", 600)


def measured(change: Callable[[SampleBlock], None]) -> Make:
    """Other samples than the formula's."""

    def make(bench: Bench, patch: pytest.MonkeyPatch) -> None:
        samples = bench.drive.samples

        def changed(command: SweepCommand) -> SampleBlock:
            block = samples(command)
            change(block)
            return block

        patch.setattr(bench.drive, "samples", changed)

    return make


def jolt(block: SampleBlock) -> None:
    block.effort[700] = 1300.0


def reversed_effort(block: SampleBlock) -> None:
    block.effort[:] = -block.effort


def commanded(make: Make = lambda _bench, _patch: None, **change: float) -> Make:
    """Other commands than the plan's."""

    def both(bench: Bench, patch: pytest.MonkeyPatch) -> None:
        compile_plan = bench.compile_plan

        def changed(campaign):
            compiled = compile_plan(campaign)
            commands = {n: dataclasses.replace(c, **change) for n, c in compiled.commands.items()}
            return dataclasses.replace(compiled, commands=commands)

        patch.setattr(bench, "compile_plan", changed)
        make(bench, patch)

    return both


def short(bench: Bench, patch: pytest.MonkeyPatch) -> None:
    move_to = bench.drive.move_to

    async def moved(joint: str, position: float, velocity: float) -> None:
        await move_to(joint, position * 0.9, velocity)

    patch.setattr(bench.drive, "move_to", moved)


def slips(bench: Bench, patch: pytest.MonkeyPatch) -> None:
    """Another axis, while this one is swept."""
    run_sweep = bench.drive.run_sweep

    async def sweep(*commands: SweepCommand):
        async for block in run_sweep(*commands):
            patch.setitem(bench.drive.position, "joint_2", 0.01)
            yield block

    patch.setattr(bench.drive, "run_sweep", sweep)


def check_move(towards: Callable[[Bench, str, float], bool], error: Exception | None = None) -> Make:
    """`towards` moves a little, and tells whether it goes on; it is a task until then."""

    def make(bench: Bench, patch: pytest.MonkeyPatch) -> None:
        async def moved(joint: str, position: float, velocity: float) -> None:
            if error is not None:
                raise error
            while towards(bench, joint, position):  # noqa: ASYNC110
                await asyncio.sleep(0.005)

        patch.setattr(bench.drive, "position", dict(bench.drive.position))
        patch.setattr(bench.drive, "move_to", moved)

    return make


STEP = math.radians(0.5) / 20  # of the drives that do not do as they are told, every few milliseconds


def away(bench: Bench, joint: str, _position: float) -> bool:
    bench.drive.position[joint] -= STEP
    return True  # until it is stopped


def coupled(bench: Bench, joint: str, position: float) -> bool:
    bench.drive.position[joint] += STEP
    bench.drive.position["joint_3"] += STEP / 2
    return bench.drive.position[joint] < position


def stuck(_bench: Bench, _joint: str, _position: float) -> bool:
    return False


def no_room(bench: Bench, patch: pytest.MonkeyPatch) -> None:
    envelope = bench.compile_plan(bench.campaign).envelope
    patch.setattr(envelope, "check_move", Mock(side_effect=EnvelopeViolation("no room")))


def full_disk(bench: Bench, patch: pytest.MonkeyPatch) -> None:
    """It takes all but the last block."""
    full = OSError(28, "No space left on device")
    patch.setattr(os, "fsync", Mock(side_effect=[*[None] * 6, full, *[None] * 100]))


FAR = "distance from the planned pose {} rad is above the limit 0.002 rad"


CASES = {
    "drive fault": Case(fails(3, DriveFault("joint_1: 0x2310")), "^DriveFault: joint_1: 0x2310$", 750),
    "lost connection": Case(fails(1, CommunicationLost("bus-off")), "^CommunicationLost: bus-off$", 250),
    "lost sample": Case(lost_sample, "^SamplesMissing: joint_1: sample 601 received instead of 600$", 500),
    "effort outside": Case(
        commanded(measured(jolt), effort_limit=1200.0), "^EnvelopeViolation: joint_1: effort 1300 N m is outside", 750
    ),
    "command outside": Case(commanded(velocity_limit=9.0), "velocity limit 9 rad/s is above the limit", moves=False),
    "implausible": Case(measured(reversed_effort), "^ImplausibleChannels: joint_1: apparent inertia -", WHOLE),
    "stands elsewhere": Case(short, f"joint_1: {FAR.format('0.04')}", sweep=2),
    "another axis slips": Case(slips, f"joint_2: {FAR.format('0.01')}", WHOLE),
    "full disk": Case(full_disk, r"^OSError: \[Errno 28\] No space left on device", WHOLE),
    "check move: no room": Case(no_room, "no room", moves=False),
    "check move: wrong way": Case(check_move(away), "^CheckMoveFailed: joint_1: moved by -"),
    "check move: another axis too": Case(check_move(coupled), r"^CheckMoveFailed: joint_3: moved by \+"),
    "check move: stuck": Case(check_move(stuck), "target not reached; limit"),
    "check move: fault": Case(check_move(stuck, DriveFault("joint_1: 0x8611")), "^DriveFault: joint_1: 0x8611$"),
}


@pytest.mark.parametrize("name", CASES)
async def test_trouble_ends_the_sweep_and_waits_for_a_person(bench: Bench, name: str) -> None:
    case = CASES[name]
    with pytest.MonkeyPatch.context() as patch:
        case.make(bench, patch)
        await bench.start()
        campaign = await bench.over()
        sweep = bench.store.sweep(campaign.id, case.sweep)
        assert sweep.state is SweepState.FAILED
        assert re.search(case.cause, sweep.cause), sweep.cause
        assert (campaign.state, campaign.cause) == (CampaignState.PAUSED, sweep.cause)
        assert campaign.sweeps[SweepState.PLANNED] == 4 - case.sweep
        assert bench.drive.trace[-1] == "stop"
        enabled = [entry for entry in bench.drive.trace if entry.startswith("enable")]
        assert bool(enabled) is case.moves
        if name.startswith("check move"):
            assert enabled in ([], ["enable joint_1"])
            assert not any(entry.startswith("sweep") for entry in bench.drive.trace)
            assert bench.drive.position["joint_2"] == 0.0
        if case.kept is None:
            with pytest.raises(NotFound):
                bench.store.recording(campaign.id, case.sweep)
        else:
            stored = bench.store.recording(campaign.id, case.sweep)
            recording = read_columns(bench.files.path(stored))
            assert stored.state is RecordingState.PARTIAL
            assert stored.samples == len(recording.time) == case.kept
            assert (recording.effort.max() == 1300.0) == (name == "effort outside")  # what ended it is kept
        assert bench.files.streams() == {}
        if name == "lost connection":
            assert (bench.machine.connected, bench.machine.trouble) == (False, "bus-off")

    await bench.resume()  # a failed sweep is repeated only on command
    assert (await bench.over()).sweeps == {SweepState.FAILED: 1, SweepState.RECORDED: 3}
