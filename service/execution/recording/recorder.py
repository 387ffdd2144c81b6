"""Writes the samples of a running sweep to the disk as they come, and makes a recording of them afterwards.

The stream is Arrow IPC: whatever happens, all blocks that the disk has taken can be read back. Samples that are
missing end the sweep; what came before them is kept and marked partial. The stream holds what the drive gave; in a
complete recording the channels are put right (`service.channels`), in a partial one they are as they came.
"""

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from drivers.ports import ChannelTiming, SampleBlock
from service.channels import align, noise_gain
from service.errors import SweepidError
from service.execution.recording.plausibility import check_channels
from service.recording import Recording, SweepSpec
from service.results.identified.manifest import Channels, Facts
from service.safety.noise_motion import Command
from service.store.documents import NewRecording, RecordingState
from service.store.files.recordings import RecordingFiles, Run
from service.store.files.stream import SampleStream, damaged, read_blocks

_COLUMNS = ("time", "effort", "velocity", "position", "velocity_setpoint")
_EXTRA = ("load_position", "excitation_effort")  # where the drive has them


class SamplesMissing(SweepidError):
    """The drive's samples have a gap, are no numbers, or end before the measured window does."""


class Gapless:
    """The samples of one sweep so far, as one block follows on the other."""

    def __init__(self) -> None:
        self.samples = 0
        self.last_time = -np.inf  # s, drive clock

    def check(self, block: SampleBlock) -> None:
        """SamplesMissing if the block does not follow on those so far, or holds what is not a number."""
        joint, expected = block.joint, np.arange(self.samples, self.samples + len(block.index))
        wrong = np.flatnonzero(block.index != expected)
        if wrong.size:
            at = wrong[0]
            raise SamplesMissing(f"{joint}: sample {block.index[at]} came where {expected[at]} was due")
        if not (np.diff(block.time, prepend=self.last_time) > 0).all():
            raise SamplesMissing(f"{joint}: time does not increase near sample {self.samples}")
        injected = () if block.excitation_effort is None else ("excitation_effort",)
        for name in (*_COLUMNS, *injected):
            if not np.isfinite(getattr(block, name)).all():
                raise SamplesMissing(f"{joint}: {name} is not a number near sample {self.samples}")

    def add(self, block: SampleBlock) -> None:
        """The block is one of them now."""
        if len(block.index):
            self.samples, self.last_time = int(block.index[-1]) + 1, float(block.time[-1])


class Recorder:
    """The stream of one sweep. Methods block until the disk has it; OSError when the disk does not take it."""

    def __init__(self, path: Path, command: Command) -> None:
        self._command = command
        self._stream = SampleStream(path)
        self._written = Gapless()

    def write(self, block: SampleBlock) -> None:
        """Append a block; SamplesMissing, and nothing written, if it does not follow on the last one written."""
        if not len(block.index):
            return
        self._written.check(block)
        names = (*_COLUMNS, *(name for name in _EXTRA if getattr(block, name) is not None))
        self._stream.write({"index": block.index, **{name: getattr(block, name) for name in names}})
        self._written.add(block)

    def check_complete(self) -> None:
        """SamplesMissing if the samples end before the measured window."""
        last = self._written.last_time
        _check_window(self._command, last, last / max(self._written.samples - 1, 1))

    def close(self) -> None:
        """Close the file."""
        self._stream.close()


def read_stream(path: Path) -> tuple[Recording, float] | None:
    """What a stream holds up to its torn end: the samples with time from 0, and the drive's time of the first, s.

    None if it holds fewer than two samples; UnreadableStream if what it holds are no samples.
    """
    columns = read_blocks(path)
    if columns is None:
        return None
    try:
        start = float(columns["time"][0])
        columns["time"] = columns["time"] - start
        load = columns.get("load_position")
        if load is not None and not np.isfinite(load).all():
            del columns["load_position"]
        return Recording(**columns), start
    except (LookupError, TypeError, ValueError) as error:
        raise damaged(path, error) from error


def finish(
    files: RecordingFiles, run: Run, planned: SweepSpec, command: Command, timing: ChannelTiming, facts: Facts
) -> tuple[SweepSpec, NewRecording]:
    """Make the recording of a complete stream, and the planned sweep with the clock it was measured on.

    ImplausibleChannels, and nothing saved, where the channels contradict one another; else they are put right by
    `timing`, and the facts say so.
    """
    path = files.stream(run)
    found = read_stream(path)
    if found is None:
        raise SamplesMissing(f"{command.joint}: the sweep gave no samples")
    recording, start = found
    rate = (len(recording.time) - 1) / float(recording.time[-1])
    spec = planned.model_copy(update={"sample_rate": round(rate, 6), "measure_from": command.measure_from - start})
    check_channels(spec, recording)
    recording = align(recording, timing)
    cut = float(recording.time[0])
    if cut:
        _check_window(command, start + float(recording.time[-1]), 1 / rate)
        spec = spec.model_copy(update={"measure_from": spec.measure_from - cut})
        recording = replace(recording, time=recording.time - cut)
    told: Facts = {**facts, "spec": spec.model_dump(mode="json"), "channels": _correction(timing, rate)}
    return spec, files.save(path.with_suffix(".parquet"), recording, RecordingState.COMPLETE, told)


def salvage(files: RecordingFiles, run: Run, facts: Facts) -> NewRecording | None:
    """Make a partial recording of what a stream holds, torn or not; None if it holds nothing.

    OSError if the disk does not take it, UnreadableStream if the stream is no stream any more.
    """
    path = files.stream(run)
    found = read_stream(path) if path.exists() else None
    if found is None:
        return None
    told: Facts = {**facts, "channels": {"corrected": False}}
    return files.save(path.with_suffix(".parquet"), found[0], RecordingState.PARTIAL, told)


def _check_window(command: Command, last: float, period: float) -> None:
    end = command.duration - command.ramp
    if last < end - 1.5 * period:
        raise SamplesMissing(f"{command.joint}: samples end at {last:.4f} s, window at {end:.4f} s")


def _correction(timing: ChannelTiming, rate: float) -> Channels:
    """What was done to the channels: s, and by how much their white noise grew."""
    if timing == ChannelTiming():
        return {"corrected": False}
    return {
        "corrected": True,
        "timing": asdict(timing),
        "noise_gain": {
            "effort": noise_gain(timing.effort_delay, timing.effort_smoothing, rate),
            "velocity": noise_gain(timing.velocity_delay, timing.velocity_smoothing, rate),
        },
    }
