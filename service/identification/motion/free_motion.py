r"""Free motion of several axes together: a log of a robot program, a trajectory without period, a foreign CSV file.

In a bundle it is a set of sweeps with the excitation "trajectory" and no sines, one per axis, with the same start,
pose, block and repeat. A set with a single axis is not a free motion of several axes: it is a record of that axis.

One zero-phase low-pass for every signal of a record; derivatives are computed in the frequency domain as well.

    H(f) = erfc((f - cut) / (sqrt(2) ROLL_OFF cut)) / 2,        d^k/dt^k:  (2 pi i f)^k H(f)

The edge is the integral of a Gaussian, so the filter's memory decays like a Gaussian of 1 / (2 pi ROLL_OFF cut) s. Ends
of a record are extended by point reflection, which keeps value and slope: correct if an axis rests at the end,
otherwise wrong by the acceleration within `memory` of the end.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from scipy.fft import next_fast_len
from scipy.special import erfc

from service import BadInput
from service.identification.axis.drive_train import TwoMassTrain
from service.identification.spectra.frequency_response import check_numbers
from service.model import Array, Complex, Robot, Sweep, SweepSpec


@dataclass(frozen=True)
class MotionBand:
    """Band of the equations, and which records are repeats."""

    roll_off: float = 0.2  # of the cut-off
    band: float = 10.0  # Hz, of the equations: below the springs of industrial robots
    # Hz, of simultaneous sweeps, 1 Hz above their lines: the higher, the more the noise of an effort moves its load
    simultaneous: float = 6.0
    payload: float = 5.0  # Hz, of a payload's equations: its gears resonate lower
    motion: float = 3.0  # times the band: cut-off of the smoothed motion, high enough to keep the whole band
    same_path: float = 0.01  # maximum difference of the paths of repeats: relative, and rad (m)
    same_place: float = 1e-3


def memory(cut: float) -> float:
    """Length of the filter on either side, s."""
    # four standard deviations of the Gaussian
    return 4.0 / (2 * np.pi * MotionBand.roll_off * cut)


def low_pass(signals: Array, rate: float, cut: float, derivative: int = 0) -> Array:
    """Signals (m, ...) along the first axis, or a derivative of them; `rate` and `cut` in Hz."""
    count = len(signals)
    pad = min(int(np.ceil(2 * memory(cut) * rate)), count - 1)
    more = min(int(next_fast_len(count + 2 * pad, real=True)) - count - pad, count - 1)  # primes are slow
    before = 2 * signals[:1] - signals[pad:0:-1]
    after = 2 * signals[-1:] - signals[-2 : -more - 2 : -1]
    # the mean of the ends is subtracted, so that numbers far from zero lose no digits
    middle = (signals[:1] + signals[-1:]) / 2
    longer = np.concatenate([before, signals, after]) - middle
    frequency = np.fft.rfftfreq(len(longer), 1 / rate)
    gain = cast(Array, erfc((frequency / cut - 1) / (np.sqrt(2) * MotionBand.roll_off))) / 2
    response = ((2j * np.pi * frequency) ** derivative * gain).reshape(-1, *[1] * (signals.ndim - 1))
    spectrum: Complex = np.fft.rfft(longer, axis=0) * response
    smooth = np.fft.irfft(spectrum, len(longer), axis=0)[pad : pad + count]
    return smooth + middle if derivative == 0 else smooth


@dataclass(frozen=True)
class FreeMotion:
    """One record. Arrays (m, k) of its k `joints`, SI on the joint side; all others stood at `pose` (n,).

    `load_position`, `load_velocity`: of the direct encoders, a dict by joint. `ids` of the sweeps, (k,).
    """

    ids: tuple[str, ...]
    joints: tuple[str, ...]
    pose: tuple[float, ...]
    block: str
    rate: float  # Hz
    effort: Array
    position: Array
    load_position: Mapping[str, Array]
    load_velocity: Mapping[str, Array]
    period: float | None = None  # s, after which the motion repeats
    highest: float = MotionBand.band  # Hz, of the equations, if the sample rate allows it

    @property
    def duration(self) -> float:
        """s."""
        return len(self.effort) / self.rate

    @property
    def motion_cut(self) -> float:
        """Cut-off of the motion, Hz."""
        return min(MotionBand.motion * self.highest, 0.35 * self.rate)  # of the sample rate

    @property
    def band(self) -> float:
        """Cut-off of the equations, Hz."""
        return min(self.highest, 0.17 * self.rate)  # of the sample rate

    def same_motion(
        self, other: "FreeMotion", same_path: float = MotionBand.same_path, same_place: float = MotionBand.same_place
    ) -> bool:
        """Whether it is a repeat: same axes, block, length and path. `same_path`, `same_place`: allowed RMS difference
        of paths, relative and in rad (m).
        """
        if (self.joints, self.block, self.rate, len(self.effort)) != (
            other.joints,
            other.block,
            other.rate,
            len(other.effort),
        ):
            return False
        apart = np.sqrt(np.mean((self.position - other.position) ** 2, axis=0))
        return bool(np.all(apart <= same_path * np.std(self.position, axis=0) + same_place))


def at_once(specs: Sequence[SweepSpec]) -> tuple[tuple[SweepSpec, ...], ...]:
    """Sets of sweeps that are free motions of several axes. Raises BadInput if an axis occurs twice in such a set."""
    groups: dict[tuple[object, ...], list[SweepSpec]] = {}
    for spec in specs:
        if spec.excitation == "trajectory" and not spec.periodic:
            groups.setdefault((spec.started_at, spec.pose, spec.block, spec.repeat), []).append(spec)
    found: list[tuple[SweepSpec, ...]] = []
    for group in groups.values():
        axes = {spec.axis for spec in group}
        if len(axes) < 2:
            continue
        if len(axes) < len(group):
            twice = next(spec for spec in group if sum(other.axis == spec.axis for other in group) > 1)
            raise BadInput(
                f"sweep {twice.id}",
                f"another record of {twice.axis} starts with it at {twice.started_at} s, among others of other axes: "
                "give each run of the robot its own started_at",
            )
        found.append(tuple(group))
    return tuple(found)


def free_motions(robot: Robot, sweeps: Sequence[Sweep]) -> tuple[FreeMotion, ...]:
    """All free motions of several axes among the sweeps. Raises BadInput if a set is inconsistent."""
    by_id = {sweep.spec.id: sweep for sweep in sweeps}
    return tuple(
        _record(robot, [robot.without_counterbalance(by_id[spec.id]) for spec in group])
        for group in at_once([sweep.spec for sweep in sweeps])
    )


def calibrated(record: FreeMotion, gains: Mapping[str, float]) -> FreeMotion:
    """With true efforts: those of the drives divided by their gains, 1 for an axis without gain."""
    return replace(record, effort=record.effort / np.array([gains.get(joint, 1.0) for joint in record.joints]))


def with_loads(record: FreeMotion, trains: Mapping[str, TwoMassTrain]) -> FreeMotion:
    """With load positions also for axes without a direct encoder: ql = qm - c (effort - Jm d2qm/dt2), smoothed."""
    loads = dict(record.load_position)
    for k, joint in enumerate(record.joints):
        train = trains.get(joint)
        if train is None or joint in loads or joint in record.load_velocity:
            continue
        effort = low_pass(record.effort[:, k], record.rate, record.motion_cut)
        acceleration = low_pass(record.position[:, k], record.rate, record.motion_cut, 2)
        loads[joint] = record.position[:, k] - train.compliance * (effort - train.motor_inertia * acceleration)
    return replace(record, load_position=loads)


def _record(robot: Robot, sweeps: Sequence[Sweep]) -> FreeMotion:
    fewest_samples = 50  # samples
    sweeps = sorted(sweeps, key=lambda sweep: robot.index(sweep.spec.axis))
    first = sweeps[0]
    for sweep in sweeps:
        spec = sweep.spec
        check_numbers(spec, sweep.recording)
        for name, mine, others in (
            ("sample_rate", spec.sample_rate, first.spec.sample_rate),
            ("measure_from", spec.measure_from, first.spec.measure_from),
            ("number of samples", len(sweep.recording.time), len(first.recording.time)),
        ):
            if mine != others:
                raise BadInput(
                    f"sweep {spec.id}",
                    f"{name} {mine} differs from {others} of sweep {first.spec.id}, which ran with it",
                )
    start = int(np.searchsorted(first.recording.time, first.spec.measure_from - 0.5 / first.spec.sample_rate))
    if len(first.recording.time) - start < fewest_samples:
        raise BadInput(f"sweep {first.spec.id}", f"fewer than {fewest_samples} samples after measure_from")
    loads = {s.spec.axis: s.recording.load_position for s in sweeps}
    speeds = {s.spec.axis: s.recording.load_velocity for s in sweeps}
    return FreeMotion(
        ids=tuple(sweep.spec.id for sweep in sweeps),
        joints=tuple(sweep.spec.axis for sweep in sweeps),
        pose=first.spec.pose,
        block=first.spec.block,
        period=first.spec.period,
        rate=first.spec.sample_rate,
        effort=np.stack([sweep.recording.effort[start:] for sweep in sweeps], -1),
        position=np.stack([sweep.recording.position[start:] for sweep in sweeps], -1),
        load_position={joint: column[start:] for joint, column in loads.items() if column is not None},
        load_velocity={
            joint: column[start:] for joint, column in speeds.items() if column is not None and loads[joint] is None
        },
    )
