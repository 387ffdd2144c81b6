"""The database refuses or the disk stalls while a campaign runs: nothing is half-stored, nothing moves unwatched."""

import asyncio
import os
import threading
from collections.abc import Iterator
from dataclasses import dataclass

import pytest
from sqlalchemy.exc import SQLAlchemyError
from structlog.testing import capture_logs

from drivers.errors import DriveFault
from service.machine.execution.runner import Runner
from service.model.errors import Conflict
from service.store.documents import CampaignState, RecordingState, SweepState
from service.store.files.columns import read_columns
from tests.unit.service.campaigns.conftest import TIMEOUT, Bench, Taken, refusing, until, until_cancelled

pytestmark = pytest.mark.slow

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


async def aborted_in_vain(bench: Bench) -> None:
    with refusing(bench):
        with pytest.raises(SQLAlchemyError):
            await asyncio.wait_for(bench.runner.abort(1, "enough"), TIMEOUT)
        await bench.over()
        assert bench.store.campaign(1).state is CampaignState.RUNNING


@pytest.mark.parametrize("command", ["abort", "start", "pause", "resume"])
async def test_the_next_command_stores_what_was_refused(faulted: Bench, command: str) -> None:
    await aborted_in_vain(faulted)
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
    assert faulted.now.sweeps == {
        "abort": {SweepState.INTERRUPTED: 1, SweepState.SKIPPED: 3},
        "resume": {SweepState.RECORDED: 4},
    }.get(command, {SweepState.INTERRUPTED: 1, SweepState.PLANNED: 3})


async def test_the_service_ends_while_the_database_refuses(faulted: Bench) -> None:
    with refusing(faulted):
        faulted.drive.go.set()
        await until(lambda: "stop" in faulted.drive.trace)
        await asyncio.wait_for(faulted.runner.close(), TIMEOUT)
        assert faulted.runner.running is None


async def test_an_abort_while_the_end_of_a_sweep_is_stored_loses_no_result(bench: Bench) -> None:
    end, inside, go = bench.store.end_sweep, threading.Event(), threading.Event()

    def slow(*args, **kwargs):
        inside.set()
        go.wait(TIMEOUT)
        return end(*args, **kwargs)

    bench.store.end_sweep = slow
    await bench.start()
    await until(inside.is_set)
    aborting = asyncio.create_task(bench.runner.abort(1, "enough"))
    await until_cancelled(1)
    go.set()
    aborted = await aborting
    assert aborted.sweeps == {SweepState.RECORDED: 1, SweepState.SKIPPED: 3}
    assert isinstance(bench.jobs, Taken)
    assert bench.jobs.sweeps == [1]
    causes = [event.data.get("cause") for event in bench.store.events(0) if event.kind.value == "campaign"]
    assert causes == ["", "", "aborted: enough", "enough"]
    assert bench.files.streams() == {}


@dataclass
class Disk:
    """One that takes nothing until `go` is set."""

    stalled: threading.Event
    go: threading.Event


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> Iterator[Disk]:
    disk, sync = Disk(threading.Event(), threading.Event()), os.fsync

    def stall(file: int) -> None:
        disk.stalled.set()
        disk.go.wait(TIMEOUT)
        sync(file)

    monkeypatch.setattr("service.store.files.columns.os.fsync", stall)
    yield disk
    disk.go.set()


async def test_samples_are_watched_while_the_disk_stalls(bench: Bench, disk: Disk) -> None:
    samples = bench.drive.samples

    def jolt(command):
        block = samples(command)
        block.velocity[1100] = 0.5
        return block

    bench.drive.samples = jolt
    await bench.start()
    await until(disk.stalled.is_set)
    await until(lambda: "stop" in bench.drive.trace)
    assert bench.drive.energised == set()
    disk.go.set()
    await bench.over()
    sweep = bench.store.sweep(1, 1)
    assert sweep.state is SweepState.FAILED
    assert sweep.cause.startswith("EnvelopeViolation: joint_1: velocity 0.5 rad/s is outside")
    recording = read_columns(bench.files.path(bench.store.recording(1, 1)))
    assert (len(recording.time), float(recording.velocity.max())) == (1250, 0.5)


async def test_a_gap_ends_the_sweep_while_the_disk_stalls(bench: Bench, disk: Disk) -> None:
    bench.drive.skip, bench.drive.hold = 600, 4  # the drive has more samples, and waits with them
    await bench.start()
    await until(lambda: "stop" in bench.drive.trace)
    disk.go.set()
    await bench.over()
    assert bench.store.sweep(1, 1).cause == "SamplesMissing: joint_1: sample 601 received instead of 600"
    assert bench.store.recording(1, 1).samples == 500


async def test_an_abort_while_the_disk_stalls_stops_the_drives_first(bench: Bench, disk: Disk) -> None:
    await bench.in_a_sweep(3)
    await until(disk.stalled.is_set)
    aborting = asyncio.create_task(bench.runner.abort(1, "enough"))
    await until(lambda: "stop" in bench.drive.trace)
    assert bench.drive.energised == set()
    disk.go.set()
    await aborting
    assert bench.store.recording(1, 1).samples == 750
