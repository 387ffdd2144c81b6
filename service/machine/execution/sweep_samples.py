"""The recording of a sweep: samples on disk as they arrive, converted afterwards, recovered if that was interrupted.

The stream is Arrow IPC: after any failure all blocks on disk can be read back. Missing samples end the sweep; the
samples before are kept and marked partial. The stream has the samples of the drive; in a complete recording the
channels are corrected (`service.model.channels`), in a partial one they are not.

After a restart, and when the database refused the data at the end of a sweep, sweeps are interrupted, campaigns paused,
and incomplete streams become partial recordings. That moves nothing.

Checks that the channels of a recording are consistent. Pure; applied to every sweep before it counts as recorded.

The samples of a drive can be wrong without any error: a channel that does not change, a wrong sign or unit of a
parameter, an encoder that loses steps. Each is detected by comparing the channels over the measured window:

    position    is the integral of velocity, with no step larger than that by velocity
    load        follows the motor
    effort      accelerates the axis: Im(E/V) > 0 at the lowest line, or takes energy about standstill; not checked
                along a trajectory, where gravity and the other axes dominate
    all         change while the axis moves; about standstill friction may hold it

Applied to the samples as reported by the drive: a delay of milliseconds does not affect the checks.
"""

from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import structlog
from structlog.contextvars import bound_contextvars

from drivers.errors import Cause, CauseCode
from drivers.ports import ChannelTiming, SampleBlock
from service import BadInput, MotionFailed, NotFound
from service.machine.execution.motion import Command
from service.model import Array, Recording, SweepSpec
from service.model.channels import align, noise_gain
from service.model.results.spectrum import ChannelCorrection, Facts
from service.planning.campaigns.state_machine import CampaignEvent, SweepEvent, campaign_move, sweep_move
from service.store.documents import CampaignState, NewRecording, RecordingState, SweepState
from service.store.files.columns import SampleStream, UnreadableStream, damaged, read_blocks
from service.store.files.recordings import RecordingFiles, SweepAttempt
from service.store.store import Store


@dataclass(frozen=True)
class Tolerances:
    """What good channels may differ by."""

    frozen: float = 0.2
    """s: no channel repeats one value for longer while the axis moves; more for a slow line, see below."""
    velocity_gain: float = 0.01
    """Encoder and speed come from one sensor: a wrong unit or gear causes far more, noise less."""
    load_gain: float = 0.05
    """Effect of gear error and twist on a few degrees of travel."""
    glitch: float = 12.0
    """Robust standard deviations: never reached by noise in 1e5 samples, nor by the tails of dry friction."""
    harmless: float = 0.5
    """Of the commanded peak velocity, or of its travel in a sample: smaller steps do not affect the result."""
    stuck: float = 0.05
    """Of the travel of the sines: an axis that moves less is held by its friction."""
    steps: float = 3.0
    """Steps of a channel's resolution allowed for rounding."""
    significant: float = 3.0
    """Times the neighbouring bins: above, an apparent inertia below zero is not noise."""


_ALLOWED = Tolerances()


class ImplausibleChannels(MotionFailed, code=CauseCode.IMPLAUSIBLE_CHANNELS):
    """The samples contradict each other: encoder, unit, sign, or a channel that does not change. Not identified."""


def check_channels(spec: SweepSpec, recording: Recording) -> None:
    """Raises ImplausibleChannels with axis, quantity, value and limit. Sweeps at standstill are not checked."""
    if not (spec.offset_velocity or spec.sines):
        return
    part = _window(spec, recording.time)
    time, effort = recording.time[part], recording.effort[part]
    velocity, position = recording.velocity[part], recording.position[part]
    load = None if recording.load_position is None else recording.load_position[part]
    if not spec.offset_velocity and _sticks(spec, time, velocity, position):
        return
    _check_frozen(spec, {"effort": effort, "velocity": velocity, "position": position})
    _check_velocity(spec, time, velocity, position)
    if load is not None:
        _check_load(spec, time, position, load)
    if spec.sines and spec.excitation != "trajectory":
        _check_effort(spec, time, effort, velocity)


def _window(spec: SweepSpec, time: Array) -> slice:
    first = int(np.searchsorted(time, spec.measure_from - 0.5 / spec.sample_rate))
    if spec.period is None or spec.periods is None:
        return slice(first, None)
    return slice(first, first + round(spec.period * spec.periods * spec.sample_rate))


def _peak(spec: SweepSpec) -> float:
    """Highest commanded speed, rad/s (m/s)."""
    return abs(spec.offset_velocity) + sum(sine.amplitude for sine in spec.sines)


def _sticks(spec: SweepSpec, time: Array, velocity: Array, position: Array) -> bool:
    """About standstill dry friction may hold an axis all the time: encoder and speed then show no travel."""
    wanted = float(np.linalg.norm([sine.amplitude / (2 * np.pi * sine.frequency) for sine in spec.sines])) / np.sqrt(2)
    ways = (_without_trend(time, position), _without_trend(time, np.cumsum(velocity) / spec.sample_rate))
    return all(float(np.std(way)) < _ALLOWED.stuck * wanted for way in ways)


def _check_frozen(spec: SweepSpec, channels: dict[str, Array]) -> None:
    # around the crest of a slow line a coarse channel may be constant for half a period
    limit = max([_ALLOWED.frozen, *(0.5 / sine.frequency for sine in spec.sines)])
    for name, values in channels.items():
        edges = np.flatnonzero(np.diff(values))
        runs = np.diff(np.concatenate([[-1], edges, [len(values) - 1]])) - 1
        longest = float(runs.max()) / spec.sample_rate
        if longest > limit:
            raise ImplausibleChannels(
                spec.axis, f"{name} stands still for {longest:.3g} s while the axis moves, limit {limit:.3g} s"
            )


def _check_velocity(spec: SweepSpec, time: Array, velocity: Array, position: Array) -> None:
    """Steps of position and velocity, and the slope of position over the integral of velocity."""
    step = np.diff(time)
    explained = step * (velocity[1:] + velocity[:-1]) / 2
    # at a reversal, backlash lets the axis move from one flank to the other
    harmless = (_ALLOWED.harmless if spec.offset_velocity else 1.0) * _peak(spec)
    _check_steps(spec, "position", np.diff(position) - explained, harmless / spec.sample_rate, _resolution(position))
    _check_steps(spec, "velocity", np.diff(velocity), harmless, _resolution(velocity))
    travelled = np.concatenate([[0.0], np.cumsum(explained)])
    # without an offset a constant error of velocity would dominate: both are then used without their trend
    slope = _slope(time, travelled, position, trend=spec.offset_velocity == 0)
    # a drive that truncates to whole units has a mean error of half a unit
    rounding = _resolution(velocity) / 2 / abs(spec.offset_velocity) if spec.offset_velocity else 0.0
    limit = _ALLOWED.velocity_gain + rounding
    if not abs(slope - 1) <= limit:
        raise ImplausibleChannels(
            spec.axis, f"position changes by {slope:.4g} times the integral of velocity, limit 1 +- {limit:.2g}"
        )


def _check_load(spec: SweepSpec, time: Array, position: Array, load: Array) -> None:
    """The direct encoder. Without an offset the load may oscillate more than the motor, or stick: it is not checked."""
    if not spec.offset_velocity:
        return
    _check_frozen(spec, {"load position": load})
    harmless = _ALLOWED.harmless * _peak(spec) / spec.sample_rate
    _check_steps(spec, "load position", np.diff(load) - np.diff(position), harmless, _resolution(load))
    slope = _slope(time, position, load, trend=False)
    if not abs(slope - 1) <= _ALLOWED.load_gain:
        raise ImplausibleChannels(
            spec.axis,
            f"the direct encoder moves {slope:.4g} times as far as the motor, limit 1 +- {_ALLOWED.load_gain}",
        )


def _check_steps(spec: SweepSpec, name: str, steps: Array, harmless: float, resolution: float) -> None:
    middle = float(np.median(steps))
    deviation = np.abs(steps - middle)
    spread = 1.4826 * float(np.median(deviation))  # standard deviation of a normal distribution
    limit = max(_ALLOWED.glitch * spread, harmless, _ALLOWED.steps * resolution)
    worst = int(np.argmax(deviation))
    if not deviation[worst] <= limit:
        raise ImplausibleChannels(
            spec.axis, f"{name} jumps {deviation[worst]:.3g} at sample {worst + 1} of the window, limit {limit:.3g}"
        )


def _check_effort(spec: SweepSpec, time: Array, effort: Array, velocity: Array) -> None:
    """Only at the lowest line: above the locked-rotor frequency the spring acts on the motor, not the load.

    About standstill presliding friction is a spring as well, at any frequency, but it takes energy.
    """
    line = min(sine.frequency for sine in spec.sines)
    turn = np.exp(-2j * np.pi * line * time)
    slow = np.exp(-2j * np.pi * np.arange(len(time)) / len(time))  # one bin further
    drive, noise = _without_trend(time, effort), 0.0
    response = np.mean(drive * turn) / np.mean(velocity * turn)
    if spec.periods is not None and spec.periods > 2:  # bins between the lines show the noise
        beside = [abs(np.mean(drive * turn * slow**k)) for k in (-1, 1)]
        noise = float(max(beside) / abs(np.mean(velocity * turn)))
    takes_energy = not spec.offset_velocity and drive @ velocity > 0
    if response.imag < -_ALLOWED.significant * noise and not takes_energy:
        raise ImplausibleChannels(
            spec.axis,
            f"apparent inertia {response.imag / (2 * np.pi * line):.4g} at {line:g} Hz is below 0: "
            "effort has the wrong sign or belongs to another axis",
        )


def _slope(time: Array, x: Array, y: Array, trend: bool) -> float:
    """Least squares slope of y over x, both without mean or trend."""
    x, y = (_without_trend(time, values) if trend else values - values.mean() for values in (x, y))
    return float(x @ y / (x @ x))


def _without_trend(time: Array, values: Array) -> Array:
    centred = time - time.mean()
    level = values - values.mean()
    return level - centred * (centred @ level) / (centred @ centred)


def _resolution(values: Array) -> float:
    """The smallest step of a channel; 0 if there is none."""
    steps = np.abs(np.diff(values))
    return float(np.min(steps, where=steps > 0, initial=np.inf)) if np.any(steps) else 0.0


_COLUMNS = ("time", "effort", "velocity", "position", "velocity_setpoint")


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
        names = (
            *_COLUMNS,
            *(name for name in ("load_position", "excitation_effort") if getattr(block, name) is not None),
        )
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
    files: RecordingFiles, run: SweepAttempt, planned: SweepSpec, command: Command, timing: ChannelTiming, facts: Facts
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


def salvage(files: RecordingFiles, run: SweepAttempt, facts: Facts) -> NewRecording | None:
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


def _correction(timing: ChannelTiming, rate: float) -> ChannelCorrection:
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


_log = structlog.get_logger(__name__)


def recover(store: Store, files: RecordingFiles) -> tuple[int, ...]:
    """Make store and files consistent before anything is started. Call it while holding the machine's lease.

    Returns the campaigns that the last process left running.
    """
    cause = Cause(CauseCode.SERVICE_ENDED, detail="the service ended during the sweep")
    left = end_runs(store, files, cause, Cause(CauseCode.SERVICE_ENDED, detail="the service was restarted"))
    store_streams(store, files, str(cause))
    return left


def store_streams(store: Store, files: RecordingFiles, cause: str) -> None:
    """Make partial recordings of the streams of ended sweeps. Call it while nothing runs.

    `cause`: why they were not stored when their sweeps ended. A stream that cannot be stored now stays.
    """
    for run, path in files.streams().items():
        with bound_contextvars(campaign=run.campaign_id, sweep=run.number):
            _look_at(store, files, run, path, cause)


def _look_at(store: Store, files: RecordingFiles, run: SweepAttempt, path: Path, cause: str) -> None:
    """Process one remaining stream."""
    if not _known(store, run):
        # of a campaign, sweep or attempt that is missing in a database restored from a backup
        _log.error("unknown_stream", path=str(files.put_aside(path, "unknown")))
        return
    _store_stream(store, files, run, path, cause)


def end_runs(store: Store, files: RecordingFiles, sweep_cause: Cause, campaign_cause: Cause) -> tuple[int, ...]:
    """Store that nothing runs; call it while nothing does. Returns the campaigns that ran."""
    for sweep in store.sweeps_in(SweepState.RUNNING):
        run = SweepAttempt(sweep.campaign_id, sweep.number, sweep.attempt)
        break_off(store, files, run, SweepEvent.INTERRUPT, sweep_cause, _facts(run))
        _log.warning("recovered", campaign=run.campaign_id, sweep=run.number)
    ran = store.campaigns_in(CampaignState.RUNNING, CampaignState.PAUSING)
    for campaign in ran:
        store.move_campaign(campaign.id, campaign_move(CampaignEvent.TROUBLE), campaign_cause)
        _log.info("campaign", campaign=campaign.id, happened=CampaignEvent.TROUBLE.value, cause=str(campaign_cause))
    return tuple(campaign.id for campaign in ran)


def break_off(
    store: Store, files: RecordingFiles, run: SweepAttempt, event: SweepEvent, cause: Cause, facts: Facts
) -> None:
    """End an unfinished run; its samples are kept as a partial recording."""
    try:
        recording = salvage(files, run, {**facts, "cause": str(cause)})
    except (OSError, UnreadableStream, BadInput) as error:  # the stream stays until the next start or resume
        cause = replace(cause, detail=f"{cause.detail}; partial recording not written: {error}")
        recording = None
    store.end_sweep(run.campaign_id, run.number, sweep_move(event), cause, None, recording)
    if recording is not None:
        files.stream(run).unlink()


def _store_stream(store: Store, files: RecordingFiles, run: SweepAttempt, path: Path, cause: str) -> None:
    """Make a recording of a remaining stream if its run has none. The stream is removed, a damaged one renamed."""
    if not _has_recording(store, run):
        try:
            recording = salvage(files, run, {**_facts(run), "cause": cause})
        except (UnreadableStream, BadInput) as error:
            aside = files.put_aside(path, "unreadable")
            _log.error("unreadable_stream", path=str(aside), reason=str(error))
            return
        except OSError as error:  # e.g. a full disk: the stream stays until the next start or resume
            _log.error("stream_left", path=str(path), reason=str(error))
            return
        if recording is not None:
            store.add_recording(run.campaign_id, run.number, run.attempt, recording)
    path.unlink()


def _facts(run: SweepAttempt) -> Facts:
    return {"campaign": run.campaign_id, "sweep": run.number}


def _known(store: Store, run: SweepAttempt) -> bool:
    try:
        return run.attempt <= store.sweep(run.campaign_id, run.number).attempt
    except NotFound:
        return False


def _has_recording(store: Store, run: SweepAttempt) -> bool:
    try:
        return store.recording(run.campaign_id, run.number).attempt >= run.attempt
    except NotFound:
        return False
