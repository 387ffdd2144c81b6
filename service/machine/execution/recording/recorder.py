"""Writes the samples of a running sweep to disk as they arrive, and converts them to a recording afterwards.

The stream is Arrow IPC: after any failure all blocks on disk can be read back. Missing samples
end the sweep; the samples before are kept and marked partial. The stream has the samples of the drive; in a
complete recording the channels are corrected (`service.model.channels`), in a partial one they are not.
"""

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from drivers.errors import CauseCode
from drivers.ports import ChannelTiming, SampleBlock
from service.machine.execution.recording.plausibility import check_channels
from service.model.channels import align, noise_gain
from service.model.errors import MotionFailed
from service.model.recording import Recording, SweepSpec
from service.model.results.identified.manifest import Channels, Facts
from service.planning.safety.noise_motion import Command
from service.store.documents import NewRecording, RecordingState
from service.store.files.columns import SampleStream, damaged, read_blocks
from service.store.files.recordings import RecordingFiles, Run

_COLUMNS = ("time", "effort", "velocity", "position", "velocity_setpoint")
_EXTRA = ("load_position", "excitation_effort")  # if the drive has them


class SamplesMissing(MotionFailed, code=CauseCode.SAMPLES_MISSING):
    """The samples of the drive have a gap, are not finite, or end before the measured window."""


class Gapless:
    """Checks that the blocks of one sweep are consecutive."""

    def __init__(self) -> None:
        self.samples = 0
        self.last_time = -np.inf  # s, drive clock

    def check(self, block: SampleBlock) -> None:
        """Raises SamplesMissing if the block does not continue the previous ones, or contains NaN."""
        joint, expected = block.joint, np.arange(self.samples, self.samples + len(block.index))
        wrong = np.flatnonzero(block.index != expected)
        if wrong.size:
            at = wrong[0]
            raise SamplesMissing(joint, f"sample {block.index[at]} received instead of {expected[at]}")
        if not (np.diff(block.time, prepend=self.last_time) > 0).all():
            raise SamplesMissing(joint, f"time does not increase near sample {self.samples}")
        injected = () if block.excitation_effort is None else ("excitation_effort",)
        for name in (*_COLUMNS, *injected):
            if not np.isfinite(getattr(block, name)).all():
                raise SamplesMissing(joint, f"{name} is not a number near sample {self.samples}")

    def add(self, block: SampleBlock) -> None:
        """Count the block as received."""
        if len(block.index):
            self.samples, self.last_time = int(block.index[-1]) + 1, float(block.time[-1])


class Recorder:
    """The stream of one sweep. Methods block until the data is on disk. Raises OSError if it cannot be written."""

    def __init__(self, path: Path, command: Command) -> None:
        self._command = command
        self._stream = SampleStream(path)
        self._written = Gapless()

    def write(self, block: SampleBlock) -> None:
        """Append a block. Raises SamplesMissing, and writes nothing, if it does not continue the last one."""
        if not len(block.index):
            return
        self._written.check(block)
        names = (*_COLUMNS, *(name for name in _EXTRA if getattr(block, name) is not None))
        self._stream.write({"index": block.index, **{name: getattr(block, name) for name in names}})
        self._written.add(block)

    def check_complete(self) -> None:
        """Raises SamplesMissing if the samples end before the measured window."""
        last = self._written.last_time
        _check_window(self._command, last, last / max(self._written.samples - 1, 1))

    def close(self) -> None:
        """Close the file."""
        self._stream.close()


def read_stream(path: Path) -> tuple[Recording, float] | None:
    """Samples of a stream up to its truncated end: with time from 0, and the drive's time of the first sample, s.

    None if there are fewer than two samples; raises UnreadableStream if the content is no samples.
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
    """Make the recording of a complete stream, and the planned sweep with its measured clock.

    Raises ImplausibleChannels, and saves nothing, if the channels contradict each other. Otherwise they are
    corrected by `timing`, which is recorded in the facts.
    """
    path = files.stream(run)
    found = read_stream(path)
    if found is None:
        raise SamplesMissing(command.joint, "the sweep returned no samples")
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
    known: Facts = {**facts, "spec": spec.model_dump(mode="json"), "channels": _correction(timing, rate)}
    return spec, files.save(path.with_suffix(".parquet"), recording, RecordingState.COMPLETE, known)


def salvage(files: RecordingFiles, run: Run, facts: Facts) -> NewRecording | None:
    """Make a partial recording of the content of a stream, truncated or not; None if it is empty.

    Raises OSError if it cannot be written, UnreadableStream if the stream is damaged.
    """
    path = files.stream(run)
    found = read_stream(path) if path.exists() else None
    if found is None:
        return None
    known: Facts = {**facts, "channels": {"corrected": False}}
    return files.save(path.with_suffix(".parquet"), found[0], RecordingState.PARTIAL, known)


def _check_window(command: Command, last: float, period: float) -> None:
    end = command.duration - command.ramp
    if last < end - 1.5 * period:
        raise SamplesMissing(command.joint, f"samples end at {last:.4f} s, window at {end:.4f} s")


def _correction(timing: ChannelTiming, rate: float) -> Channels:
    """Correction applied to the channels: s, and the growth of their white noise."""
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
