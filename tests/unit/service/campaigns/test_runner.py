"""Campaigns in front of a formula machine: order of motion, trouble, stop, pause, abort, repeat."""

import asyncio
import threading
from pathlib import Path

import numpy as np
import pytest

from drivers.errors import CommunicationLost, DriveFault
from service.model.errors import Conflict
from service.model.recording import Recording
from service.store.documents import CampaignState, RecordingState, SweepState
from service.store.files.recordings import SweepAttempt
from service.store.store import StaleVersion
from tests.unit.service.campaigns.conftest import TIMEOUT, Bench, Taken, until, until_cancelled

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
    def refuse(path: Path, recording: Recording) -> None:
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


async def test_stop_reaches_the_drives_first_and_holds_the_machine(bench: Bench) -> None:
    await bench.in_a_sweep()
    told_before = bench.store.last_event_id()
    stop = await bench.machine.stop("operator", "hose caught")
    assert "stop" in bench.drive.trace
    await bench.over()
    sweep = bench.store.sweep(bench.campaign.id, 1)
    assert (sweep.state, sweep.cause) == (SweepState.INTERRUPTED, "stopped by operator: hose caught")
    assert bench.now.state is CampaignState.PAUSED
    await bench.machine.noted()
    assert [held.why for held in bench.machine.stops] == ["hose caught"]
    assert "stop" in [event.kind.value for event in bench.store.events(told_before)]
    with pytest.raises(Conflict, match="may not move: stopped by operator: hose caught"):
        await bench.resume()
    bench.drive.hold = None
    await bench.machine.reset_stop("operator", [stop.id])
    await bench.resume(repeat=True)
    assert (await bench.over()).state is CampaignState.MEASURED


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


async def test_an_abort_in_the_moment_in_which_a_sweep_begins_leaves_none_running(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    begin, begins, go = bench.store.begin_sweep, threading.Event(), threading.Event()

    def slow(*arguments):
        begins.set()
        go.wait(TIMEOUT)
        return begin(*arguments)

    monkeypatch.setattr(bench.store, "begin_sweep", slow)
    await bench.start()
    await until(begins.is_set)
    aborting = asyncio.create_task(bench.runner.abort(bench.campaign.id, "enough"))
    await until_cancelled(bench.campaign.id)
    go.set()
    aborted = await aborting
    assert aborted.sweeps == {SweepState.INTERRUPTED: 1, SweepState.SKIPPED: 3}
    assert not any(entry.startswith(("enable", "move", "sweep")) for entry in bench.drive.trace)


async def test_a_second_start_is_refused_while_one_runs(bench: Bench) -> None:
    await bench.in_a_sweep(0)
    with pytest.raises(Conflict, match="campaign 1 is running"):
        await bench.start()
    with pytest.raises(Conflict, match="in use by campaign 1"):
        await bench.machine.connect()
    with pytest.raises(Conflict, match="in use by campaign 1"):
        await bench.machine.acknowledge("joint_1")
    bench.drive.go.set()
    await bench.over()


async def test_a_lost_connection_has_to_be_made_again(bench: Bench) -> None:
    bench.drive.fail[1] = CommunicationLost("bus-off")
    await bench.start()
    await bench.over()
    bench.drive.fail.clear()
    await bench.resume(repeat=True)
    assert (await bench.over()).sweeps == {SweepState.RECORDED: 4}
    assert bench.drive.trace.count("connect") == 2
    again = bench.store.recording(bench.campaign.id, 1)
    assert (again.attempt, again.state) == (2, RecordingState.COMPLETE)
