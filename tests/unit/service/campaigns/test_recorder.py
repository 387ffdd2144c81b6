"""The stream on the disk, complete, torn, with gaps; and what a service that was killed has left."""

import asyncio
import dataclasses
import hashlib
import json
import os
import sqlite3
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, nullcontext, suppress
from pathlib import Path
from typing import Any, cast

import numpy as np
import psutil
import pytest

from drivers.errors import Cause, CauseCode
from drivers.ports import ChannelTiming, SampleBlock, SineCommand, SweepCommand, SweepMode
from service.machine.execution import sweep_executor
from service.machine.execution.sweep_executor import BegunSweep, Incoming
from service.machine.execution.sweep_samples import Recorder, SamplesMissing, finish, read_stream, recover, salvage
from service.model import SweepSpec
from service.planning.campaigns.state_machine import CampaignEvent, SweepEvent, campaign_move, sweep_move
from service.store.documents import CampaignState, RecordingState, SweepState
from service.store.files.columns import UnreadableStream, read_columns
from service.store.files.recordings import RecordingFiles, SweepAttempt
from tests.unit.service.campaigns.conftest import POSES, Again, Bench, command

pytestmark = pytest.mark.slow


RUN = SweepAttempt(campaign_id=1, number=3, attempt=1)


RATE = 1000.0


COMMAND = SweepCommand(
    joint="joint_1",
    mode=SweepMode.DRIVE_SIDE,
    offset_velocity=0.01,
    sines=(SineCommand(2.0, 0.002, 0.0),),
    period=1.0,
    periods=1,
    ramp=0.1,
    settle=0.1,
    sample_rate=RATE,
    velocity_limit=1.0,
    effort_limit=100.0,
    position_window=(-1.0, 1.0),
)


SPEC = SweepSpec(id="0003", axis="joint_1", pose=(0.0,) * 6, offset_velocity=0.01, sample_rate=500.0, measure_from=0.2)


def block(start: int, stop: int, late: float = 0.0) -> SampleBlock:
    """Samples whose time is that of the middle of a cycle when `late` is half a cycle."""
    index = np.arange(start, stop)
    time = np.asarray((index + late) / RATE, np.float64)
    return SampleBlock("joint_1", index, time, 3 * time, 2 * time, time**2, time, load_position=1.02 * time**2)


def changed(**columns: np.ndarray) -> SampleBlock:
    """Samples 100 and 101 with other columns."""
    return dataclasses.replace(block(100, 102), **columns)


@pytest.fixture
def files(tmp_path: Path) -> RecordingFiles:
    return RecordingFiles(tmp_path)


def recorded(path: Path, samples: int, late: float = 0.0, command: SweepCommand = COMMAND) -> Recorder:
    """A stream of so many samples in blocks of 100, closed."""
    recorder = Recorder(path, command)
    for start in range(0, samples, 100):
        recorder.write(block(start, min(start + 100, samples), late))
    recorder.close()
    return recorder


def test_a_complete_stream_becomes_a_recording_with_manifest(files: RecordingFiles) -> None:
    recorded(files.stream(RUN), 1300, late=0.5).check_complete()
    spec, new = finish(files, RUN, SPEC, COMMAND, ChannelTiming(), {"campaign": 1})
    path = files.stream(RUN).with_suffix(".parquet")
    recording = read_columns(path)
    assert new.state is RecordingState.COMPLETE
    assert new.samples == len(recording.time) == 1300
    assert new.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    # the drive's first sample is half a cycle late: time starts at 0, the window moves with it
    assert recording.time[0] == 0.0
    assert (spec.sample_rate, spec.measure_from) == (RATE, pytest.approx(0.2 - 0.5e-3, abs=1e-12))
    drive_time = (np.arange(1300) + 0.5) / RATE
    np.testing.assert_array_equal(recording.effort, 3 * drive_time)
    np.testing.assert_array_equal(recording.load_position, 1.02 * drive_time**2)
    manifest = json.loads(path.with_suffix(".json").read_text())
    assert (manifest["sha256"], manifest["state"], manifest["campaign"]) == (new.sha256, "complete", 1)
    assert manifest["spec"]["measure_from"] == spec.measure_from
    assert manifest["channels"] == {"corrected": False}
    assert sorted(p.name for p in path.parent.iterdir()) == ["0003-1.arrows", "0003-1.json", "0003-1.parquet"]


def test_a_complete_recording_is_corrected_and_says_so(files: RecordingFiles) -> None:
    """Effort 4 ms late on a ramp: 4 more is what it should have been, and the window stays where it was."""
    timing = ChannelTiming(effort_delay=3e-3, effort_smoothing=1e-3)
    recorded(files.stream(RUN), 1300)
    spec, new = finish(files, RUN, SPEC, COMMAND, timing, {})
    path = files.stream(RUN).with_suffix(".parquet")
    recording = read_columns(path)
    cut = 3e-3  # six samples of the filter, less three of the delay
    assert spec.measure_from == pytest.approx(COMMAND.measure_from - cut, abs=1e-12)
    assert recording.time[0] == 0.0
    np.testing.assert_allclose(recording.effort, 3 * (recording.time + cut + 4e-3), atol=1e-9)
    np.testing.assert_allclose(recording.position, (recording.time + cut) ** 2, atol=1e-12)
    assert new.samples == 1300 - 12
    channels = json.loads(path.with_suffix(".json").read_text())["channels"]
    assert channels["corrected"] is True
    assert channels["timing"]["effort_delay"] == 3e-3
    assert channels["noise_gain"]["velocity"] == 1.0 < channels["noise_gain"]["effort"]


def test_the_correction_may_not_cut_into_the_window(files: RecordingFiles) -> None:
    recorded(files.stream(RUN), 1201)
    with pytest.raises(SamplesMissing, match=r"samples end at 1\.19"):
        finish(files, RUN, SPEC, COMMAND, ChannelTiming(effort_delay=2e-3), {})


@pytest.mark.parametrize(
    ("before", "bad", "message"),
    [
        (100, block(101, 200), "sample 101 received instead of 100"),
        (100, block(99, 200), "sample 99 received instead of 100"),
        (100, changed(index=np.array([100, 102])), "sample 102 received instead of 101"),
        (100, changed(effort=np.array([1.0, np.nan])), "effort is not a number near sample 100"),
        (100, changed(time=np.array([0.1, 0.1])), "time does not increase near sample 100"),
        (0, block(1, 100), "sample 1 received instead of 0"),
    ],
)
def test_a_gap_ends_the_sweep_and_keeps_what_came_before(
    files: RecordingFiles, before: int, bad: SampleBlock, message: str
) -> None:
    recorder = Recorder(files.stream(RUN), COMMAND)
    if before:
        recorder.write(block(0, before))
    with pytest.raises(SamplesMissing, match=message):
        recorder.write(bad)
    recorder.close()
    new = salvage(files, RUN, {})
    assert (new and (new.state, new.samples)) == ((RecordingState.PARTIAL, before) if before else None)


async def test_a_stream_that_was_being_opened_when_the_sweep_was_cancelled_is_closed(
    files: RecordingFiles, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened, go_on = threading.Event(), threading.Event()
    kept: list[Recorder] = []  # not closed by the garbage collection

    class SlowRecorder(Recorder):
        def __init__(self, path: Path, command: SweepCommand) -> None:
            super().__init__(path, command)
            kept.append(self)
            opened.set()
            assert go_on.wait(60)

    monkeypatch.setattr(sweep_executor, "Recorder", SlowRecorder)
    nothing = cast("Any", None)
    with ThreadPoolExecutor(1) as disk:
        recording = Incoming([BegunSweep(nothing, RUN, COMMAND, {})], nothing, nothing, nothing, disk)
        opening = asyncio.create_task(recording.open(files))
        assert await asyncio.to_thread(opened.wait, 60)
        opening.cancel()
        with pytest.raises(asyncio.CancelledError):
            await opening  # which does not wait for the disk
        recording.close()
        go_on.set()
    assert [file.path for file in psutil.Process().open_files() if file.path == str(files.stream(RUN))] == []


@pytest.mark.parametrize("count", [1190, 1199, 1200])
def test_samples_must_reach_the_end_of_the_window(files: RecordingFiles, count: int) -> None:
    missing = pytest.raises(SamplesMissing, match=r"samples end at 1\.1[0-9]+ s, window at 1\.2000 s")
    with missing if count < 1200 else nullcontext():
        recorded(files.stream(RUN), count).check_complete()


@pytest.mark.parametrize("cut", [1, 100, 700])
def test_a_torn_stream_gives_back_all_but_the_torn_block(files: RecordingFiles, cut: int) -> None:
    path = files.stream(RUN)
    recorded(path, 500)
    os.truncate(path, path.stat().st_size - cut)
    found = read_stream(path)
    assert found is not None
    assert len(found[0].time) == 400


def test_the_injected_torque_of_a_noise_run_is_recorded(files: RecordingFiles) -> None:
    recorder = Recorder(files.stream(RUN), COMMAND)
    for start in range(0, 1300, 100):
        whole = block(start, start + 100)
        recorder.write(dataclasses.replace(whole, excitation_effort=np.sin(whole.time)))
    with pytest.raises(SamplesMissing, match="excitation_effort is not a number"):
        recorder.write(dataclasses.replace(block(1300, 1400), excitation_effort=np.full(100, np.nan)))
    recorder.close()
    found = read_stream(files.stream(RUN))
    assert found is not None
    assert found[0].excitation_effort == pytest.approx(np.sin(found[0].time))


@pytest.fixture
def stored(files: RecordingFiles) -> tuple[Path, bytes]:
    """A stream of five blocks, and what it holds."""
    path = files.stream(RUN)
    recorded(path, 500)
    return path, path.read_bytes()


@pytest.mark.slow
def test_a_stream_whose_tail_a_power_cut_left_zeroed_gives_back_what_is_before_it(stored: tuple[Path, bytes]) -> None:
    path, whole = stored
    for end in range(0, len(whole), 56):
        path.write_bytes(whole[:end] + bytes(len(whole) - end))
        found = read_stream(path)
        # a block that lost a part of its numbers alone is not told from a whole one
        assert found is None or len(found[0].time) in range(100, 501, 100)


@pytest.mark.parametrize("name", [b"velocity_setpoiwt", b"\xbdelocity_setpoint"])
def test_a_stream_with_a_damaged_head_says_so(stored: tuple[Path, bytes], name: bytes) -> None:
    path, whole = stored
    path.write_bytes(whole.replace(b"velocity_setpoint", name))
    with pytest.raises(UnreadableStream, match=r"0003-1\.arrows is damaged"):
        read_stream(path)


def test_whatever_a_stream_holds_it_is_read_or_called_unreadable(stored: tuple[Path, bytes]) -> None:
    path, whole = stored
    rng = np.random.default_rng(1)
    for _ in range(500):
        damaged = bytearray(whole)
        for at in rng.integers(0, 2000, size=10):  # the schema and the head of the first block
            damaged[at] = rng.integers(256)
        path.write_bytes(damaged)
        with suppress(UnreadableStream):
            read_stream(path)


def streamed(bench: Bench, run: SweepAttempt, samples: int = 100) -> None:
    """A stream that a service has left."""
    recorded(bench.files.stream(run), samples, command=command(bench.store.sweep(1, 1)))


async def test_after_a_kill_nothing_moves_and_the_samples_so_far_are_kept(again: Again) -> None:
    """The files are those of a service that was killed in its first sweep; by SIGKILL: `tests/system/test_stop.py`."""
    async with again() as bench:
        bench.store.move_campaign(1, campaign_move(CampaignEvent.START))
        bench.store.begin_sweep(1, 1, sweep_move(SweepEvent.BEGIN))
        streamed(bench, SweepAttempt(1, 1, 1), 750)
    async with again() as bench:
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


@pytest.mark.parametrize("samples", [100, 0])
@pytest.mark.parametrize("run", [SweepAttempt(99, 1, 1), SweepAttempt(1, 99, 1), SweepAttempt(1, 1, 1)])
async def test_a_stream_of_a_run_that_the_database_does_not_know_is_put_aside(
    bench: Bench, samples: int, run: SweepAttempt
) -> None:
    streamed(bench, run, samples)
    recover(bench.store, bench.files)
    assert bench.files.streams() == {}
    assert bench.files.stream(run).with_name(f"{bench.files.stream(run).name}.unknown").exists()


def restore(folder: Path) -> None:
    for part in folder.glob("sweepid.sqlite*"):
        part.unlink()
    (folder / "backup").rename(folder / "sweepid.sqlite")


async def test_a_database_from_a_backup_measures_on_and_loses_no_recording(again: Again, tmp_path: Path) -> None:
    """Restored as it was before the campaign ran; a stream of the run that it forgot lies about as well."""
    async with again() as bench:
        with (
            closing(sqlite3.connect(tmp_path / "sweepid.sqlite")) as source,
            closing(sqlite3.connect(tmp_path / "backup")) as to,
        ):
            source.backup(to)
        await bench.start()
        await bench.over()
        streamed(bench, SweepAttempt(1, 2, 1))  # as if killed between the commit and the removal of the stream
        recover(bench.store, bench.files)
        assert bench.files.streams() == {}
        measured = [bench.store.recording(1, sweep.number) for sweep in bench.store.sweeps(1)]
        assert {recording.state for recording in measured} == {RecordingState.COMPLETE}
        streamed(bench, SweepAttempt(1, 2, 1))
    before = {bench.files.path(recording): bench.files.path(recording).read_bytes() for recording in measured}
    restore(tmp_path)
    async with again() as bench:
        recover(bench.store, bench.files)
        await bench.start()
        await bench.over()
        assert bench.store.campaign(1).sweeps == {SweepState.RECORDED: len(POSES)}
        assert {sweep.attempt for sweep in bench.store.sweeps(1)} == {2}
        for sweep in bench.store.sweeps(1):
            bench.files.load(bench.store.recording(1, sweep.number))
    assert {path: path.read_bytes() for path in before} == before


async def test_a_damaged_stream_is_put_aside_and_the_service_starts(bench: Bench) -> None:
    for number in (1, 2, 3):
        begun = bench.store.begin_sweep(1, number, sweep_move(SweepEvent.BEGIN))
        streamed(bench, SweepAttempt(1, number, begun.attempt))
    bench.store.move_sweep(1, 2, sweep_move(SweepEvent.FAIL), Cause(CauseCode.NOT_STORED))
    streams = {run.number: path for run, path in bench.files.streams().items()}
    for number in (1, 2):
        streams[number].write_bytes(streams[number].read_bytes().replace(b"velocity_setpoint", b"velocity_setpoiwt"))
    recover(bench.store, bench.files)
    first, second, third = bench.store.sweeps(1)[:3]
    assert [first.state, third.state] == [SweepState.INTERRUPTED] * 2
    assert second.state is SweepState.FAILED
    assert "0001-1.arrows is damaged" in first.cause
    assert bench.store.recording(1, 3).samples == 100
    aside = sorted(path.name for path in streams[1].parent.glob("*.unreadable"))
    assert aside == ["0001-1.arrows.unreadable", "0002-1.arrows.unreadable"]
    assert bench.files.streams() == {}
