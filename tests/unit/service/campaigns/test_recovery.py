"""The service is killed while an axis moves, or its disk is full; and started again."""

import json
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest

from service.campaigns.state_machine import SweepEvent, sweep_move
from service.execution.recording.recorder import Recorder
from service.execution.recording.recovery import recover
from service.robot import Robot
from service.safety.envelope import Envelope
from service.store.database import open_database
from service.store.documents import CampaignState, RecordingState, SweepState
from service.store.files.recordings import RecordingFiles, Run
from service.store.store import Store
from tests.unit.service.campaigns.conftest import POSES, ROOT, command, open_bench
from tests.unit.service.campaigns.test_recorder import block

pytestmark = pytest.mark.slow

SERVICE = """
import asyncio, json, resource, sys
from pathlib import Path
from service.geometry.cell import Cell
from service.safety.envelope import Envelope
from service.execution.recording.recorder import read_stream
from service.configuration import read_robot
from tests.unit.service.campaigns import conftest

async def main(folder, what):
    robot = read_robot(conftest.ROOT / "config" / "robots" / "max100-class.yaml")
    async with conftest.open_bench(folder, robot, Envelope(robot, Cell(name="empty"))) as bench:
        if what == "hold":
            bench.drive.hold = 3
        else:
            resource.setrlimit(resource.RLIMIT_FSIZE, (2**21, 2**21))
            conftest.RATE = 20_000.0
        await bench.runner.start(bench.campaign.id, bench.intention)
        if what == "hold":
            await bench.drive.holding.wait()
            (stream,) = bench.files.streams().values()
            while (found := read_stream(stream)) is None or len(found[0].time) < 750:
                await asyncio.sleep(0.01)  # the disk follows the drive
            print("holding", flush=True)
        await bench.runner.finished()
        sweep = bench.store.sweep(bench.campaign.id, 1)
        campaign = bench.store.campaign(bench.campaign.id)
        print(json.dumps({
            "trace": bench.drive.trace, "energised": list(bench.drive.energised), "sweep": sweep.state.value,
            "cause": sweep.cause, "campaign": campaign.state.value,
            "streams": len(bench.files.streams()),
        }))

asyncio.run(main(Path(sys.argv[1]), sys.argv[2]))
"""


def service(folder: Path, what: str) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        [sys.executable, "-W", "error", "-c", SERVICE, str(folder), what], stdout=subprocess.PIPE, text=True, cwd=ROOT
    )


async def test_after_a_kill_nothing_moves_and_the_samples_so_far_are_kept(
    tmp_path: Path, robot: Robot, envelope: Envelope
) -> None:
    with service(tmp_path, "hold") as killed:
        assert killed.stdout is not None
        while killed.stdout.readline() != "holding\n":
            assert killed.poll() is None
        killed.kill()
    async with open_bench(tmp_path, robot, envelope) as bench:
        recover(bench.store, bench.files)
        campaign = bench.store.campaign(bench.campaign.id)
        assert (campaign.state, campaign.cause) == (CampaignState.PAUSED, "the service was restarted")
        assert campaign.sweeps == {SweepState.INTERRUPTED: 1, SweepState.PLANNED: len(POSES) - 1}
        partial = bench.store.recording(campaign.id, 1)
        assert (partial.state, partial.samples) == (RecordingState.PARTIAL, 750)
        assert len(bench.files.load(partial).time) == 750
        assert bench.files.streams() == {}
        assert bench.drive.trace == []
        before = bench.store.last_event_id()
        recover(bench.store, bench.files)
        assert bench.store.last_event_id() == before
        await bench.runner.resume(campaign.id, bench.intention, repeat=True)
        await bench.runner.finished()
        assert bench.store.campaign(campaign.id).sweeps == {SweepState.RECORDED: len(POSES)}


def test_a_full_disk_stops_the_drives_and_fails_the_sweep(tmp_path: Path) -> None:
    with service(tmp_path, "disk") as process:
        out, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    told = json.loads(out.splitlines()[-1])
    assert told["sweep"] == "failed"
    assert told["cause"].startswith("OSError: [Errno 27] File too large")
    assert told["campaign"] == "paused"
    assert told["energised"] == []
    assert told["trace"][-1] == "stop"
    with open_database(f"sqlite:///{tmp_path / 'sweepid.sqlite'}") as database:
        store, files = Store(database), RecordingFiles(tmp_path)
        recover(store, files)  # what the full disk did not take then
        partial = store.recording(1, 1)
        assert partial.state is RecordingState.PARTIAL
        assert partial.samples > 30_000
        assert len(files.load(partial).time) == partial.samples


async def test_a_stream_whose_recording_is_stored_goes(tmp_path: Path, robot: Robot, envelope: Envelope) -> None:
    async with open_bench(tmp_path, robot, envelope) as bench:
        await bench.runner.start(bench.campaign.id, bench.intention)
        await bench.runner.finished()
        # killed between the commit and the removal of the stream
        recorder = Recorder(bench.files.stream(Run(bench.campaign.id, 2, 1)), command(bench.store.sweep(1, 2)))
        recorder.write(block(0, 100))
        recorder.close()
        recover(bench.store, bench.files)
        assert bench.files.streams() == {}
        assert bench.store.recording(1, 2).state is RecordingState.COMPLETE


@pytest.mark.parametrize("what", ["samples", "nothing"])
@pytest.mark.parametrize("run", [Run(99, 1, 1), Run(1, 99, 1), Run(1, 1, 1)])
async def test_a_stream_of_a_run_that_the_database_does_not_know_is_put_aside(
    tmp_path: Path, robot: Robot, envelope: Envelope, what: str, run: Run
) -> None:
    async with open_bench(tmp_path, robot, envelope) as bench:
        recorder = Recorder(bench.files.stream(run), command(bench.store.sweep(1, 1)))
        if what == "samples":
            recorder.write(block(0, 100))
        recorder.close()
        aside = bench.files.stream(run).with_name(f"{bench.files.stream(run).name}.unknown")
        recover(bench.store, bench.files)
        assert bench.files.streams() == {}
        assert aside.exists()


def restore(folder: Path, backup: bytes) -> None:
    for part in folder.glob("sweepid.sqlite*"):
        part.unlink()
    (folder / "sweepid.sqlite").write_bytes(backup)


async def test_a_database_from_a_backup_measures_on_and_loses_no_recording(
    tmp_path: Path, robot: Robot, envelope: Envelope
) -> None:
    """Restored as it was before the campaign ran; a stream of the run that it forgot lies about as well."""
    async with open_bench(tmp_path, robot, envelope) as bench:
        with (
            closing(sqlite3.connect(tmp_path / "sweepid.sqlite")) as source,
            closing(sqlite3.connect(":memory:")) as to,
        ):
            source.backup(to)
            backup = to.serialize()
        await bench.runner.start(1, bench.intention)
        await bench.runner.finished()
        measured = [bench.files.path(bench.store.recording(1, sweep.number)) for sweep in bench.store.sweeps(1)]
        recorder = Recorder(bench.files.stream(Run(1, 2, 1)), command(bench.store.sweep(1, 2)))
        recorder.write(block(0, 100))
        recorder.close()
    restore(tmp_path, backup)
    before = {path: path.read_bytes() for path in measured}
    async with open_bench(tmp_path, robot, envelope) as bench:
        recover(bench.store, bench.files)
        await bench.runner.start(1, bench.intention)
        await bench.runner.finished()
        assert bench.store.campaign(1).sweeps == {SweepState.RECORDED: len(POSES)}
        assert {sweep.attempt for sweep in bench.store.sweeps(1)} == {2}
        for sweep in bench.store.sweeps(1):
            bench.files.load(bench.store.recording(1, sweep.number))
    assert {path: path.read_bytes() for path in measured} == before


async def test_a_damaged_stream_is_put_aside_and_the_service_starts(
    tmp_path: Path, robot: Robot, envelope: Envelope
) -> None:
    async with open_bench(tmp_path, robot, envelope) as bench:
        for number in (1, 2, 3):
            begun = bench.store.begin_sweep(1, number, sweep_move(SweepEvent.BEGIN))
            recorder = Recorder(bench.files.stream(Run(1, number, begun.attempt)), command(begun))
            recorder.write(block(0, 100))
            recorder.close()
            if number == 2:
                bench.store.move_sweep(1, number, sweep_move(SweepEvent.FAIL), "disk full")  # its stream was left
        streams = {run.number: path for run, path in bench.files.streams().items()}
        for number in (1, 2):
            streams[number].write_bytes(
                streams[number].read_bytes().replace(b"velocity_setpoint", b"velocity_setpoiwt")
            )
        recover(bench.store, bench.files)
        first, second, third = bench.store.sweeps(1)[:3]
        assert (first.state, second.state, third.state) == (
            SweepState.INTERRUPTED,
            SweepState.FAILED,
            SweepState.INTERRUPTED,
        )
        assert "0001-1.arrows is damaged" in first.cause
        assert bench.store.recording(1, 3).samples == 100
        assert sorted(path.name for path in streams[1].parent.glob("*.unreadable")) == [
            "0001-1.arrows.unreadable",
            "0002-1.arrows.unreadable",
        ]
        assert bench.files.streams() == {}
