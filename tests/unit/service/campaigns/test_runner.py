"""Campaigns in front of a formula machine: order of motion, trouble, stop, pause, abort, repeat."""

import asyncio
import dataclasses
import threading
from pathlib import Path

import numpy as np
import pytest

from drivers.errors import CommunicationLost, DriveFault
from service.errors import Conflict
from service.recording import Recording
from service.store.documents import CampaignState, RecordingState, SweepState
from service.store.files.columns import read_columns
from service.store.files.recordings import Run
from service.store.store import StaleVersion
from tests.unit.service.campaigns.conftest import TIMEOUT, Bench, Taken, until, until_cancelled

pytestmark = pytest.mark.slow


async def run_out(bench: Bench) -> None:
    await asyncio.wait_for(bench.runner.finished(), TIMEOUT)
    assert bench.runner.running is None
    assert bench.drive.energised == set()


def state(bench: Bench) -> CampaignState:
    return bench.store.campaign(bench.campaign.id).state


async def test_a_campaign_runs_to_its_end(bench: Bench) -> None:
    started = await bench.runner.start(bench.campaign.id, bench.intention)
    assert (started.state, bench.runner.running) == (CampaignState.RUNNING, bench.campaign.id)
    await run_out(bench)
    assert state(bench) is CampaignState.MEASURED
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


async def test_one_axis_has_energy_at_a_time_and_only_to_move(bench: Bench) -> None:
    await bench.runner.start(bench.campaign.id, bench.intention)
    await run_out(bench)
    # the check move comes first; each sweep starts where the last one ended: joint_1 goes back to its pose first
    assert [entry for entry in bench.drive.trace if entry != "standstill"][1:14] == [
        "connect",
        "enable joint_1",
        "move joint_1 0.00872665",
        "move joint_1 0",
        "disable joint_1",
        "enable joint_1",
        "sweep joint_1",
        "disable joint_1",
        "enable joint_1",
        "move joint_1 0.4",
        "disable joint_1",
        "enable joint_1",
        "sweep joint_1",
    ]
    energised: set[str] = set()
    for entry in bench.drive.trace:
        what, _, rest = entry.partition(" ")
        if what == "enable":
            assert energised == set()
            energised.add(rest)
        elif what in ("move", "sweep"):
            assert energised == {rest.split()[0]}
        elif what == "disable":
            energised.discard(rest)


async def test_a_drive_fault_stops_the_machine_and_waits_for_a_person(bench: Bench) -> None:
    bench.drive.fail[3] = DriveFault("joint_1: 0x2310 over-current")
    await bench.runner.start(bench.campaign.id, bench.intention)
    await run_out(bench)
    campaign = bench.store.campaign(bench.campaign.id)
    assert (campaign.state, campaign.cause) == (CampaignState.PAUSED, "DriveFault: joint_1: 0x2310 over-current")
    assert campaign.sweeps == {SweepState.FAILED: 1, SweepState.PLANNED: 3}
    assert bench.drive.trace[-1] == "stop"
    partial = bench.store.recording(campaign.id, 1)
    assert (partial.state, partial.samples) == (RecordingState.PARTIAL, 750)
    assert len(bench.files.load(partial).time) == 750


async def test_a_failed_sweep_is_repeated_only_on_command(bench: Bench) -> None:
    bench.drive.fail[3] = DriveFault("over-current")
    await bench.runner.start(bench.campaign.id, bench.intention)
    await run_out(bench)
    bench.drive.fail.clear()
    await bench.runner.resume(bench.campaign.id, bench.intention)
    await run_out(bench)
    assert [s.state for s in bench.store.sweeps(bench.campaign.id)] == [SweepState.FAILED, *[SweepState.RECORDED] * 3]


async def test_what_the_disk_refused_is_stored_when_the_campaign_goes_on(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(path: Path, recording: Recording) -> None:
        raise OSError(30, "Read-only file system", str(path))

    bench.drive.fail[3] = DriveFault("over-current")
    with monkeypatch.context() as read_only:
        read_only.setattr("service.store.files.recordings.write_columns", refuse)
        await bench.runner.start(bench.campaign.id, bench.intention)
        await run_out(bench)
    assert "partial recording not written: [Errno 30] Read-only file system" in bench.store.sweep(1, 1).cause
    assert list(bench.files.streams()) == [Run(1, 1, 1)]
    bench.drive.fail.clear()
    await bench.runner.resume(bench.campaign.id, bench.intention)
    await run_out(bench)
    partial = bench.store.recording(bench.campaign.id, 1)
    assert (partial.state, partial.samples) == (RecordingState.PARTIAL, 750)
    assert len(bench.files.load(partial).time) == 750
    assert bench.files.streams() == {}


async def test_repeat_measures_failed_sweeps_once_more(bench: Bench) -> None:
    bench.drive.fail[3] = DriveFault("over-current")
    await bench.runner.start(bench.campaign.id, bench.intention)
    await run_out(bench)
    bench.drive.fail.clear()
    await bench.runner.resume(bench.campaign.id, bench.intention, repeat=True)
    await run_out(bench)
    assert bench.store.campaign(bench.campaign.id).sweeps == {SweepState.RECORDED: 4}
    again = bench.store.recording(bench.campaign.id, 1)
    assert (again.attempt, again.state) == (2, RecordingState.COMPLETE)


async def test_a_lost_sample_fails_the_sweep(bench: Bench) -> None:
    bench.drive.skip = 600
    await bench.runner.start(bench.campaign.id, bench.intention)
    await run_out(bench)
    sweep = bench.store.sweep(bench.campaign.id, 1)
    assert sweep.state is SweepState.FAILED
    assert sweep.cause == "SamplesMissing: joint_1: sample 601 received instead of 600"
    assert bench.store.recording(bench.campaign.id, 1).samples == 500
    assert "stop" in bench.drive.trace


async def test_samples_outside_of_the_envelope_stop_the_machine_and_are_kept(bench: Bench) -> None:
    bench.drive.position["joint_1"] = 0.0015  # still within the tolerance of the pose
    compile_plan = bench.compile_plan

    def narrow(campaign):
        compiled = compile_plan(campaign)
        commands = {n: dataclasses.replace(c, effort_limit=1200.0) for n, c in compiled.commands.items()}
        return dataclasses.replace(compiled, commands=commands)

    bench.compile_plan = narrow
    samples = bench.drive.samples

    def jolt(command):
        block = samples(command)
        block.effort[700] = 1300.0
        return block

    bench.drive.samples = jolt
    await bench.runner.start(bench.campaign.id, bench.intention)
    await run_out(bench)
    sweep = bench.store.sweep(bench.campaign.id, 1)
    assert sweep.state is SweepState.FAILED
    assert sweep.cause.startswith("EnvelopeViolation: joint_1: effort 1300 N m is outside")
    recording = read_columns(bench.files.path(bench.store.recording(bench.campaign.id, 1)))
    assert float(recording.effort.max()) == 1300.0


async def test_a_command_outside_of_the_envelope_moves_nothing(bench: Bench) -> None:
    compile_plan = bench.compile_plan

    def fast(campaign):
        compiled = compile_plan(campaign)
        commands = {n: dataclasses.replace(c, velocity_limit=9.0) for n, c in compiled.commands.items()}
        return dataclasses.replace(compiled, commands=commands)

    bench.compile_plan = fast
    await bench.runner.start(bench.campaign.id, bench.intention)
    await run_out(bench)
    assert bench.drive.trace == ["close", "connect", "stop"]
    assert "velocity limit 9 rad/s is above the limit" in bench.store.sweep(bench.campaign.id, 1).cause


async def test_an_axis_that_is_not_where_it_should_be_is_found(bench: Bench) -> None:
    move_to = bench.drive.move_to

    async def short(joint, position, velocity):
        await move_to(joint, position * 0.9, velocity)

    bench.drive.move_to = short
    await bench.runner.start(bench.campaign.id, bench.intention)
    await run_out(bench)
    sweep = bench.store.sweep(bench.campaign.id, 2)
    assert sweep.state is SweepState.FAILED
    assert "joint_1: distance from the planned pose 0.04 rad is above the limit 0.002 rad" in sweep.cause


async def test_an_axis_that_slips_during_another_ones_sweep_spoils_no_result(bench: Bench) -> None:
    bench.drive.hold = 2
    await bench.runner.start(bench.campaign.id, bench.intention)
    await asyncio.wait_for(bench.drive.holding.wait(), TIMEOUT)
    bench.drive.position["joint_2"] += 0.01
    bench.drive.hold = None
    bench.drive.go.set()
    await run_out(bench)
    sweep = bench.store.sweep(bench.campaign.id, 1)
    assert sweep.state is SweepState.FAILED
    assert "joint_2: distance from the planned pose 0.01 rad is above the limit 0.002 rad" in sweep.cause
    assert bench.store.recording(bench.campaign.id, 1).state is RecordingState.PARTIAL


async def test_stop_reaches_the_drives_first_and_holds_the_machine(bench: Bench) -> None:
    bench.drive.hold = 2
    await bench.runner.start(bench.campaign.id, bench.intention)
    await asyncio.wait_for(bench.drive.holding.wait(), TIMEOUT)
    told_before = bench.store.last_event_id()
    stop = await bench.machine.stop("operator", "hose caught")
    assert "stop" in bench.drive.trace
    await run_out(bench)
    sweep = bench.store.sweep(bench.campaign.id, 1)
    assert (sweep.state, sweep.cause) == (SweepState.INTERRUPTED, "stopped by operator: hose caught")
    assert state(bench) is CampaignState.PAUSED
    await bench.machine.noted()
    assert [held.why for held in bench.machine.stops] == ["hose caught"]
    assert "stop" in [event.kind.value for event in bench.store.events(told_before)]
    with pytest.raises(Conflict, match="may not move: stopped by operator: hose caught"):
        await bench.runner.resume(bench.campaign.id, bench.intention)
    bench.drive.hold = None
    await bench.machine.reset_stop("operator", [stop.id])
    await bench.runner.resume(bench.campaign.id, bench.intention, repeat=True)
    await run_out(bench)
    assert state(bench) is CampaignState.MEASURED


async def test_a_stop_while_a_drive_is_being_enabled_leaves_no_energy(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    enable = bench.drive.enable

    async def slow(joint):
        stopping = asyncio.create_task(bench.machine.stop("operator", "now"))
        await until(lambda: "stop" in bench.drive.trace)
        await enable(joint)  # the drive's answer comes after the stop
        await stopping

    monkeypatch.setattr(bench.drive, "enable", slow)
    await bench.runner.start(bench.campaign.id, bench.intention)
    await run_out(bench)
    assert not any(entry.startswith(("sweep", "move")) for entry in bench.drive.trace)
    assert bench.store.sweep(bench.campaign.id, 1).state is SweepState.INTERRUPTED


async def test_a_stop_that_the_drives_do_not_confirm_is_latched_all_the_same(bench: Bench) -> None:
    await bench.machine.connect()
    bench.drive.stop_error = CommunicationLost("node 1 is silent")
    with pytest.raises(CommunicationLost):
        await bench.machine.stop("operator", "smoke")
    assert bench.machine.latched is not None
    with pytest.raises(Conflict):
        bench.machine.check_may_move(bench.intention)


async def test_pause_holds_after_the_present_sweep(bench: Bench) -> None:
    bench.drive.hold = 2
    await bench.runner.start(bench.campaign.id, bench.intention)
    await asyncio.wait_for(bench.drive.holding.wait(), TIMEOUT)
    assert (await bench.runner.pause(bench.campaign.id)).state is CampaignState.PAUSING
    bench.drive.go.set()
    await run_out(bench)
    campaign = bench.store.campaign(bench.campaign.id)
    assert (campaign.state, campaign.cause) == (CampaignState.PAUSED, "paused by request")
    assert campaign.sweeps == {SweepState.RECORDED: 1, SweepState.PLANNED: 3}


async def test_a_pause_can_be_taken_back(bench: Bench) -> None:
    bench.drive.hold = 2
    await bench.runner.start(bench.campaign.id, bench.intention)
    await asyncio.wait_for(bench.drive.holding.wait(), TIMEOUT)
    await bench.runner.pause(bench.campaign.id)
    assert (await bench.runner.resume(bench.campaign.id, bench.intention)).state is CampaignState.RUNNING
    bench.drive.go.set()
    await run_out(bench)
    assert state(bench) is CampaignState.MEASURED


async def test_a_resume_that_meets_the_pause_leaves_no_campaign_running_that_nothing_runs(bench: Bench) -> None:
    bench.drive.hold = 2
    await bench.runner.start(bench.campaign.id, bench.intention)
    await asyncio.wait_for(bench.drive.holding.wait(), TIMEOUT)
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
    resuming = asyncio.create_task(bench.runner.resume(bench.campaign.id, bench.intention))
    await asyncio.sleep(0)  # it waits for its turn, behind that command, while the campaign comes to its pause
    bench.drive.hold = None
    bench.drive.go.set()
    await run_out(bench)
    go.set()
    with pytest.raises(StaleVersion):
        await refused
    with pytest.raises(Conflict, match="resume it again"):
        await resuming
    assert state(bench) is CampaignState.PAUSED
    await bench.runner.resume(bench.campaign.id, bench.intention)
    await run_out(bench)
    assert state(bench) is CampaignState.MEASURED


async def test_abort_stops_the_sweep_and_skips_the_rest(bench: Bench) -> None:
    bench.drive.hold = 2
    await bench.runner.start(bench.campaign.id, bench.intention)
    await asyncio.wait_for(bench.drive.holding.wait(), TIMEOUT)
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
    await bench.runner.start(bench.campaign.id, bench.intention)
    await until(begins.is_set)
    aborting = asyncio.create_task(bench.runner.abort(bench.campaign.id, "enough"))
    await until_cancelled(bench.campaign.id)
    go.set()
    aborted = await aborting
    assert aborted.sweeps == {SweepState.INTERRUPTED: 1, SweepState.SKIPPED: 3}
    assert not any(entry.startswith(("enable", "move", "sweep")) for entry in bench.drive.trace)


async def test_a_second_start_is_refused_while_one_runs(bench: Bench) -> None:
    bench.drive.hold = 0
    await bench.runner.start(bench.campaign.id, bench.intention)
    await asyncio.wait_for(bench.drive.holding.wait(), TIMEOUT)
    with pytest.raises(Conflict, match="campaign 1 is running"):
        await bench.runner.start(bench.campaign.id, bench.intention)
    with pytest.raises(Conflict, match="in use by campaign 1"):
        await bench.machine.connect()
    with pytest.raises(Conflict, match="in use by campaign 1"):
        await bench.machine.acknowledge("joint_1")
    bench.drive.go.set()
    await run_out(bench)


async def test_a_lost_connection_has_to_be_made_again(bench: Bench) -> None:
    bench.drive.fail[1] = CommunicationLost("bus-off")
    await bench.runner.start(bench.campaign.id, bench.intention)
    await run_out(bench)
    assert (bench.machine.connected, bench.machine.trouble) == (False, "bus-off")
    bench.drive.fail.clear()
    await bench.runner.resume(bench.campaign.id, bench.intention, repeat=True)
    await run_out(bench)
    assert bench.drive.trace.count("connect") == 2
    assert state(bench) is CampaignState.MEASURED


async def test_subscribers_see_the_running_sweep(bench: Bench) -> None:
    with bench.hub.subscribe(bench.campaign.id) as queue:
        await bench.runner.start(bench.campaign.id, bench.intention)
        await run_out(bench)
        bench.hub.close()
        finite = {(block.number, bool(np.isfinite(block.effort).all())) async for block in queue}
    assert finite == {(1, True), (2, True), (3, True), (4, True)}
