r"""The data of a trajectory used by identification: the harmonics of every axis up to `BAND`, and its noise.

Over P whole periods of the fundamental 1/T every signal of the periodic motion has only multiples of 1/T; the bins
between them contain only noise. The position is the measured motion: its derivatives are iw X and -w^2 X, exact for
signals below the band's end, so velocity and acceleration need no difference quotient and gravity no integration.

X_h = 1/N sum_n x_n exp(-2 pi i h n P / N) as in `frequency_response`; X_0 is the mean.

A simultaneous sweep is such a record over one period, its window, in which axes also turn with a constant offset. The
path of the offset is kept as a slope beside the harmonics. Gravity changes along it, so efforts do not return to where
they began: their straight line is removed here, and a jump between end and start is eliminated from the equations.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from service import BadInput
from service.identification.axis.drive_train import TwoMassTrain
from service.identification.model import JointMotion
from service.identification.motion.free_motion import MotionBand
from service.identification.spectra.frequency_response import check_numbers, from_pairs, pairs, way_of, window
from service.model import Array, Complex, Robot, Sweep, SweepSpec
from service.model.results.spectrum import TrackDocument


@dataclass(frozen=True)
class AxisTrack:
    """One axis: harmonics 0 to h of effort (h + 1,), more of the positions, and the noise of an effort harmonic.

    `noise`: standard deviation of its real and of its imaginary part, N m (N), from the scatter between periods;
    None with a single period. `load_position`: None without a direct encoder. `slope`, rad/s (m/s): mean velocity of a
    simultaneous sweep, whose path is not in the harmonics of the positions; 0 for other trajectories.
    """

    spec: SweepSpec
    effort: Complex
    position: Complex
    load_position: Complex | None
    noise: float | None
    slope: float = 0.0

    @property
    def joint(self) -> str:
        return self.spec.axis

    def to_document(self) -> TrackDocument:
        """For a file; floats are stored without loss."""
        return {
            "spec": self.spec.model_dump(mode="json"),
            "harmonics": pairs(self.effort),
            "position": pairs(self.position),
            "load_position": None if self.load_position is None else pairs(self.load_position),
            "noise": self.noise,
            "slope": self.slope,
        }

    @classmethod
    def from_document(cls, document: TrackDocument) -> "AxisTrack":
        """The inverse of `to_document`."""
        load = document["load_position"]
        return cls(
            spec=SweepSpec.model_validate(document["spec"]),
            effort=from_pairs(document["harmonics"]),
            position=from_pairs(document["position"]),
            load_position=None if load is None else from_pairs(load),
            noise=document["noise"],
            slope=document.get("slope", 0.0),
        )


@dataclass(frozen=True)
class TrajectoryRecord:
    """One run of several axes together; the joints without a track stood at `pose` (n,), rad (m)."""

    pose: tuple[float, ...]
    period: float  # s
    periods: int
    tracks: tuple[AxisTrack, ...]

    @property
    def frequency(self) -> Array:
        """Of the effort's harmonics (h + 1,), Hz."""
        return np.arange(len(self.tracks[0].effort)) / self.period

    @property
    def sloped(self) -> bool:
        """Whether it is a simultaneous sweep."""
        return any(track.slope for track in self.tracks)

    def motion(self, robot: Robot, samples: int, *, load: bool) -> JointMotion:
        """Motion (samples, all joints) over one period, of the loads if they were measured, or of the motors."""
        position, velocity, acceleration = np.zeros((3, samples, len(robot.axes)))
        position[:] = self.pose
        for track in self.tracks:
            index = robot.index(track.joint)
            harmonics = track.load_position if load and track.load_position is not None else track.position
            omega = 2j * np.pi * np.arange(len(harmonics)) / self.period
            along = track.slope * self.period * np.arange(samples) / samples
            position[:, index] = in_time(harmonics, samples) + along
            velocity[:, index] = in_time(omega * harmonics, samples) + track.slope
            acceleration[:, index] = in_time(omega**2 * harmonics, samples)
        return JointMotion(position, velocity, acceleration)

    def effort(self, samples: int) -> Array:
        """Measured efforts (samples, tracks) over one period, below the band's end, N m (N)."""
        return np.stack([in_time(track.effort, samples) for track in self.tracks], -1)


def axis_track(sweep: Sweep) -> AxisTrack:
    """What is kept of one axis' recording; BadInput where it does not hold the whole periods, a sample is not a finite
    number, or an axis with an offset has several periods."""
    spec, record = sweep.spec, sweep.recording
    check_numbers(spec, record)
    first, count = window(spec, record.time)
    part, periods = slice(first, first + count), spec.periods or 1
    if spec.offset_velocity and periods > 1:
        raise BadInput(
            f"sweep {spec.id}",
            f"has an offset of {spec.offset_velocity:.4g} and {periods} periods; limit 1 for axes that move at once: "
            "state the whole window as its period",
        )
    time = np.arange(count) / spec.sample_rate
    slope, trend = 0.0, 0.0
    if spec.offset_velocity:
        # of a periodic velocity, so that the rest of the path is periodic
        slope = float(way_of(record.position, first, count)[-1]) * spec.sample_rate / count
        trend = float(np.polyfit(time, record.effort[part], 1)[0])
    # sticking before a reversal is only visible far above `BAND`
    of_motion = round(0.4 * spec.sample_rate * (spec.period or 0.0))
    band = MotionBand.simultaneous if slope else MotionBand.band
    highest = min(round(band * (spec.period or 0.0)), of_motion)
    effort: Complex = np.fft.rfft(record.effort[part])[: periods * (highest + 1)] / count
    between = np.arange(len(effort)) % periods != 0
    noise = float(np.sqrt(np.mean(np.abs(effort[between]) ** 2) / 2)) if periods > 1 else None

    def harmonics(signal: Array, last: int, line: Array) -> Complex:
        transform: Complex = np.fft.rfft(signal[part] - line)
        return transform[: periods * last + 1 : periods] / count

    return AxisTrack(
        spec=spec,
        effort=harmonics(record.effort, highest, trend * (time - time.mean())),
        position=harmonics(record.position, of_motion, slope * time),
        load_position=None
        if record.load_position is None
        else harmonics(record.load_position, of_motion, slope * time),
        noise=noise,
        slope=slope,
    )


def runs_at_once(spec: SweepSpec) -> bool:
    """Whether it is one axis of an exciting trajectory. Other axes with its block, pose and start may have moved with
    it.
    """
    return spec.excitation == "trajectory" and spec.periodic


def trajectories(robot: Robot, tracks: Sequence[AxisTrack]) -> tuple[TrajectoryRecord, ...]:
    """Tracks grouped by block, pose and start. Raises BadInput if a group is inconsistent.

    A trajectory with missing axes according to its block is left out.
    """
    groups: dict[tuple[object, ...], list[AxisTrack]] = {}
    for track in tracks:
        spec = track.spec
        groups.setdefault((spec.block, spec.started_at, spec.pose, spec.repeat), []).append(track)
    return tuple(trajectory(robot, group) for group in groups.values() if len(group) >= group[0].spec.axes_at_once)


def trajectory(robot: Robot, tracks: Sequence[AxisTrack]) -> TrajectoryRecord:
    """One trajectory of axes that moved together. Raises BadInput if they are inconsistent."""
    first = tracks[0].spec
    for track in tracks:
        robot.index(track.joint)
        for name in ("pose", "period", "periods", "measure_from", "sample_rate"):
            mine, others = getattr(track.spec, name), getattr(first, name)
            if mine != others:
                raise BadInput(f"sweep {track.spec.id}", f"{name} {mine} differs from {others} of sweep {first.id}")
    axes = [track.joint for track in tracks]
    if len(set(axes)) < len(axes):
        raise BadInput(f"sweep {first.id}", f"its trajectory has an axis twice: {', '.join(axes)}")
    return TrajectoryRecord(first.pose, first.period or 0.0, first.periods or 0, tuple(tracks))


def calibrated(record: TrajectoryRecord, gains: Mapping[str, float]) -> TrajectoryRecord:
    """With true efforts: those of the drives divided by their gains, 1 for an axis without gain."""

    def true(track: AxisTrack, gain: float) -> AxisTrack:
        return replace(track, effort=track.effort / gain, noise=track.noise and track.noise / gain)

    return replace(record, tracks=tuple(true(track, gains.get(track.joint, 1.0)) for track in record.tracks))


def with_loads(
    record: TrajectoryRecord, trains: Mapping[str, TwoMassTrain], noise: Mapping[str, Complex] | None = None
) -> TrajectoryRecord:
    """With load positions also without a direct encoder: ql = qm - c (effort - Jm d2qm/dt2).

    Friction of the motor, which does not act on the spring, is left out. `trains`: drive trains from a joint fit; an
    axis without one counts as stiff. `noise`: part of the harmonics of an effort, by sweep, that moves no load.
    """
    omega = 2j * np.pi * record.frequency
    tracks: list[AxisTrack] = []
    for track in record.tracks:
        train = trains.get(track.joint)
        if track.load_position is None and train is not None:
            motor = track.position[: len(omega)]
            velocity = omega * motor + track.slope * (omega == 0)
            drive = (train.motor_inertia * omega + train.motor_friction) * velocity
            torque = track.effort - (noise or {}).get(track.spec.id, 0.0) - drive
            twist = train.compliance * torque / (1 + train.damping_time * omega)
            track = replace(track, load_position=motor - twist)
        tracks.append(track)
    return replace(record, tracks=tuple(tracks))


def in_time(harmonics: Complex, samples: int) -> Array:
    """A real signal (samples,) over one period from its harmonics, without those above half of the sample rate."""
    spectrum = np.zeros(samples // 2 + 1, dtype=complex)
    kept = harmonics[: samples // 2]
    spectrum[: len(kept)] = kept
    return np.fft.irfft(spectrum * samples, samples)
