"""The service is killed while an axis moves, or its disk is full; and started again."""

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from drivers.errors import Cause, CauseCode
from service.machine.execution.recording import Recorder, recover
from service.model.robot import Robot
from service.planning.campaigns.state_machine import CampaignEvent, SweepEvent, campaign_move, sweep_move
from service.planning.safety.envelope import Envelope
from service.store.documents import CampaignState, RecordingState, SweepState
from service.store.files.recordings import SweepAttempt
from tests.unit.service.campaigns.conftest import POSES, Bench, command, open_bench
from tests.unit.service.campaigns.test_recorder import block

pytestmark = pytest.mark.slow


def streamed(bench: Bench, run: SweepAttempt, samples: int = 100) -> None:
    """A stream that a service has left."""
    recorder = Recorder(bench.files.stream(run), command(bench.store.sweep(1, 1)))
    if samples:
        recorder.write(block(0, samples))
    recorder.close()


async def test_after_a_kill_nothing_moves_and_the_samples_so_far_are_kept(
    tmp_path: Path, robot: Robot, envelope: Envelope
) -> None:
    """The files are those of a service that was killed in its first sweep; by SIGKILL: `tests/system/test_stop.py`."""
    async with open_bench(tmp_path, robot, envelope) as bench:
        bench.store.move_campaign(1, campaign_move(CampaignEvent.START))
        bench.store.begin_sweep(1, 1, sweep_move(SweepEvent.BEGIN))
        streamed(bench, SweepAttempt(1, 1, 1), 750)
    async with open_bench(tmp_path, robot, envelope) as bench:
        recover(bench.store, bench.files)
        campaign = bench.now
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
        await bench.resume(repeat=True)
        assert (await bench.over()).sweeps == {SweepState.RECORDED: len(POSES)}


async def test_a_stream_whose_recording_is_stored_goes(tmp_path: Path, robot: Robot, envelope: Envelope) -> None:
    async with open_bench(tmp_path, robot, envelope) as bench:
        await bench.start()
        await bench.over()
        # killed between the commit and the removal of the stream
        streamed(bench, SweepAttempt(1, 2, 1))
        recover(bench.store, bench.files)
        assert bench.files.streams() == {}
        assert bench.store.recording(1, 2).state is RecordingState.COMPLETE


@pytest.mark.parametrize("samples", [100, 0])
@pytest.mark.parametrize("run", [SweepAttempt(99, 1, 1), SweepAttempt(1, 99, 1), SweepAttempt(1, 1, 1)])
async def test_a_stream_of_a_run_that_the_database_does_not_know_is_put_aside(
    tmp_path: Path, robot: Robot, envelope: Envelope, samples: int, run: SweepAttempt
) -> None:
    async with open_bench(tmp_path, robot, envelope) as bench:
        streamed(bench, run, samples)
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
        await bench.start()
        await bench.over()
        measured = [bench.files.path(bench.store.recording(1, sweep.number)) for sweep in bench.store.sweeps(1)]
        streamed(bench, SweepAttempt(1, 2, 1))
    restore(tmp_path, backup)
    before = {path: path.read_bytes() for path in measured}
    async with open_bench(tmp_path, robot, envelope) as bench:
        recover(bench.store, bench.files)
        await bench.start()
        await bench.over()
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
            streamed(bench, SweepAttempt(1, number, begun.attempt))
            if number == 2:
                left = Cause(CauseCode.NOT_STORED)
                bench.store.move_sweep(1, number, sweep_move(SweepEvent.FAIL), left)
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
