"""CAD and estimate compared on sweeps that were not used in the estimate, by the effort that each predicts.

The tested estimate uses the training sweeps of all axes and no held-out sweep. Its gravity is that of its physical
standard parameters: the part that the inertias do not determine is that of CAD. The measured inertia in a held-out pose
is that of an estimate from all sweeps, with its covariance.

The sweeps of an axis are grouped by pose in the order of the bundle; every `EVERY`th pose is held out with all its
sweeps, a rule that is independent of the results. Sweeps are of one pose if all other joints have the same position:
the axis itself may start at either end.

A monitor compares measured and predicted effort at each sample, and gives an alarm if they differ by more than L. False
alarms: one in `QUIET_HOURS` h of samples at the drive's rate, that is a probability p = 1 / (3600 QUIET_HOURS rate) per
sample, about 3e-8 at 1 kHz. Minutes of recordings have too few samples for an empirical quantile at this probability,
so a Gaussian tail is assumed, with the mean m_s and the standard deviation s_s of each sweep:

    mean over s of  Phi(-(L - m_s)/s_s) + Phi(-(L + m_s)/s_s)  =  p

Differences between poses (gravity, friction) are not noise that changes with each sample: one Gaussian over all poses
would multiply them by 5.5 and make the better model look too good. L is never less than the largest recorded
difference. An external effort of L is just detected if there is no other difference. Single samples are assumed
independent, so the requirement is higher than for the filtered monitors of real controls.

The effort that a rigid-body model predicts in a sweep, and the residual of the measured effort.

    effort(t) = sum over lines of Z Omega  +  G cos d + k sin d  +  mu v_mean  +  a + b sign(v)

Z = Z(J) is the drive train's impedance (`axis_inertia`) with the model's inertia J, Omega the measured velocity at the
line, d the measured distance from the start pose; G and k the model's gravity. Only J, G and k differ between models.
The drive train is the same for both models: spring, damping, rotor and viscous friction from the training sweeps,
because CAD contains none of these; mu is viscous friction on both sides of it. Dry friction a, b is fitted to the means
of the training sweeps for each model; it absorbs the constant part of its gravity error. So friction is no
disadvantage for either model, and they differ only in their rigid bodies. (A fitted factor of v_mean would
absorb more: if a plan selects speeds by pose, it looks like gravity.) All efforts are torques of the drive: an error
of the torque constant is the same in measured and identified effort.

The feed-forward of each model is along a path at working speed, from the first measured pose towards the most distant
one, all axes at the same time, on

    s = 10 u^3 - 15 u^4 + 6 u^5,   u = t / T,   peak speed 15/8 D/T,

T follows from the joints' speed limits. A measured axis whose pose never varied moves half of the longest way. Effort
is the rigid inverse dynamics of the model (`inverse_dynamics`) with the friction of the estimate, the same for both:
viscous from the drive train, dry from the means of the sweeps. No sweep contains such a motion: it is an extrapolation.
"""

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr, ndtri

from service import BadInput
from service.identification.axis.axis_estimate import AxisEstimate
from service.identification.axis.drive_train import TwoMassTrain, impedance
from service.identification.estimates.estimate import RobotEstimate, identify
from service.identification.estimates.standard_parameters import standard_parameters
from service.identification.model import JointMotion, axis_rows, dynamics_rows, gravity_terms
from service.identification.spectra.frequency_response import Spectrum, spectrum, window
from service.model import Array, Complex, Indices, Robot, Sweep, SweepSpec, joint_end, link_frames
from service.model.results.effect import Number, Value
from service.model.results.part import Document, Part
from service.model.urdf import read_origin


@dataclass(frozen=True)
class RigidAxis:
    """The rigid-body model of an axis in a pose; SI units on the joint side."""

    inertia: float  # kg m^2 (kg)
    gravity_torque: float  # N m (N)
    gravity_stiffness: float  # N m/rad


@dataclass(frozen=True)
class Window:
    """The measured window of a sweep, arrays (n,); `bins` of its DFT are the excited lines, `speed` (b,) there."""

    effort: Array
    way: Array
    velocity: Array
    bins: Indices
    frequency: Array  # (b,) Hz
    speed: Complex


def window_of(sweep: Sweep, spectrum: Spectrum, own: int) -> Window:
    """The window of a sweep with lines of joint number `own`; BadInput if its record is too short."""
    spec, record = sweep.spec, sweep.recording
    first, count = window(spec, record.time)
    part = slice(first, first + count)
    frequency = spectrum.frequency[spectrum.line]
    return Window(
        effort=record.effort[part],
        way=record.position[part] - spec.pose[own],
        velocity=record.velocity[part],
        bins=np.round(frequency * count / spec.sample_rate).astype(int),
        frequency=frequency,
        speed=spectrum.velocity[spectrum.line],
    )


def left_by(body: RigidAxis, train: TwoMassTrain, measured: Window) -> Array:
    """Measured effort (n,) minus inertia, gravity, the drive train's part at the lines and its viscous friction."""
    count = len(measured.effort)
    lines = np.zeros(count // 2 + 1, dtype=np.complex128)
    z = impedance(measured.frequency, train, body.inertia - train.motor_inertia, 0.0)
    lines[measured.bins] = z.total * measured.speed
    swing = np.fft.irfft(lines, count) * count
    gravity = body.gravity_torque * np.cos(measured.way) + body.gravity_stiffness * np.sin(measured.way)
    viscous = (train.motor_friction + train.load_friction) * measured.velocity.mean()
    return np.asarray(measured.effort - swing - gravity - viscous, dtype=float)


def dry_friction(left: Sequence[Array], measured: Sequence[Window]) -> Array:
    """a and b of the module docstring: least squares over the means of `left` of each sweep, (2,).

    If the sweeps do not separate them (one direction), the shortest vector: its prediction is the same.
    """
    rows = np.array([_dry(one).mean(axis=0) for one in measured])
    return np.asarray(np.linalg.lstsq(rows, np.array([one.mean() for one in left]), rcond=None)[0], dtype=float)


def without_friction(left: Array, measured: Window, friction: Array) -> Array:
    """The residual (n,) after subtraction of dry friction."""
    return np.asarray(left - _dry(measured) @ friction, dtype=float)


def lines_power(signal: Array, measured: Window) -> float:
    """Mean square of the component of a signal (n,) at the excited lines."""
    amplitudes = np.fft.rfft(signal)[measured.bins] / len(signal)
    return 2 * float(np.sum(np.abs(amplitudes) ** 2))


def _dry(measured: Window) -> Array:
    return np.stack([np.ones_like(measured.velocity), np.sign(measured.velocity)], -1)


@dataclass(frozen=True)
class FeedForward:
    """The path's motion (n, joints), one row each ms, and the effort (n, joints) of both models, N m (N)."""

    motion: JointMotion
    cad: Array
    identified: Array


def feed_forward(robot: Robot, sweeps: Sequence[Sweep], place: str = "recordings") -> FeedForward:
    """From the sweeps with lines; BadInput where there is none."""
    used = [sweep for sweep in sweeps if sweep.spec.periodic and sweep.spec.shows_inertia]
    if not used:
        raise BadInput(place, "has no sweep of one axis with offset and sines")
    spectra = {sweep.spec.id: spectrum(robot, sweep) for sweep in used}
    estimate = identify(robot, list(spectra.values()))
    identified = standard_parameters(estimate).parameters
    motors = [axis.reflected_motor_inertia or 0.0 for axis in robot.axes]
    nominal = np.concatenate([robot.chain.inertial.ravel(), motors])
    moved = [robot.index(axis.joint) for axis in estimate.axes]
    motion = path_between(*_ends(robot, estimate.poses, moved), [joint.velocity for joint in robot.chain.joints])
    rows = dynamics_rows(robot.chain, robot.gravity, motion)
    friction = _friction(robot, estimate, identified, used, spectra)
    carried = robot.counterbalance_efforts(motion.position)
    cad, own = (rows @ np.concatenate([parameters, friction]) + carried for parameters in (nominal, identified))
    return FeedForward(motion, cad, own)


def path_between(start: Array, end: Array, limits: Sequence[float]) -> JointMotion:
    """Path from one pose (joints,) to another at 0.6 of the speed `limits` of the joints, rad/s (m/s), and 0.2 s of
    rest before and after; one row each ms."""
    way = end - start
    duration = 15 / 8 * float(np.max(np.abs(way) / (0.6 * np.array(limits))))
    count = max(2, round(1e3 * duration))
    u, taken = np.arange(count + 1) / count, 1e-3 * count
    rest = np.zeros(200)
    place = np.concatenate([rest, 10 * u**3 - 15 * u**4 + 6 * u**5, rest + 1])
    speed = np.concatenate([rest, (30 * u**2 - 60 * u**3 + 30 * u**4) / taken, rest])
    gain = np.concatenate([rest, (60 * u - 180 * u**2 + 120 * u**3) / taken**2, rest])
    return JointMotion(start + place[:, None] * way, speed[:, None] * way, gain[:, None] * way)


def _ends(robot: Robot, poses: Array, moved: Sequence[int]) -> tuple[Array, Array]:
    """Two poses (joints,): the first, and one on the way to the most distant from it, within the joints' limits."""
    start = poses[0].copy()
    end = poses[int(np.argmax(np.linalg.norm(poses - start, axis=1)))].copy()
    way, same = 0.8, 2e-3  # rad (m): at most, so that the motion is as fast as usual for a robot; no motion
    end = start + (end - start) * min(1.0, way / max(float(np.abs(end - start).max()), same))
    for number in moved:
        joint = robot.chain.joints[number]
        if abs(end[number] - start[number]) < same:
            away = way / 2 if start[number] + way / 2 <= joint.upper else -way / 2
            end[number] = np.clip(start[number] + away, joint.lower, joint.upper)
    return start, end


def _friction(
    robot: Robot, estimate: RobotEstimate, parameters: Array, sweeps: Sequence[Sweep], spectra: dict[str, Spectrum]
) -> Array:
    """Viscous and dry friction and offset of each joint, (3 n,)."""
    friction = np.zeros((3, len(robot.axes)))
    for axis in estimate.axes:
        number = robot.index(axis.joint)
        own = [sweep for sweep in sweeps if sweep.spec.axis == axis.joint]
        if axis.fit is None:
            continue
        poses = np.array([sweep.spec.pose for sweep in own])
        inertia = axis_rows(robot.chain, number, poses) @ parameters
        gravity = gravity_terms(robot.chain, parameters, robot.gravity, number, poses)
        means: list[float] = []
        signs: list[float] = []
        for sweep, j, (g, k) in zip(own, inertia, gravity, strict=True):
            window = window_of(robot.without_counterbalance(sweep), spectra[sweep.spec.id], number)
            means.append(float(left_by(RigidAxis(float(j), float(g), float(k)), axis.fit.train, window).mean()))
            signs.append(float(np.sign(window.velocity).mean()))
        friction[0, number] = axis.fit.train.motor_friction + axis.fit.train.load_friction
        friction[1, number] = np.dot(signs, means) / np.dot(signs, signs)
    return friction.ravel()


QUIET_HOURS = 8.0  # one shift
ON_THE_AXIS = 0.01  # m: if nearer, a force at the end has no torque about the axis
EVERY = 4


class ModelBenefit(Part):
    """One model on the held-out sweeps of an axis; N m (N), for prismatic axes in brackets.

    `effort_rms` and `effort_peak` of measured minus predicted effort, sample by sample; `lines_rms` of its part at the
    excited lines, `left_percent` that part over the measured one. `inertia_percent`: RMS over the held-out sweeps of
    model minus measured inertia, relative. `inertia_error`: the same in kg m^2 (kg), which is N m for each rad/s^2.
    `smallest_effort`: the smallest external effort that the monitor can detect; `smallest_force` at the robot's end
    that causes it, N, null if that end is on the axis.
    """

    effort_rms: Number
    effort_peak: Number
    lines_rms: Number
    left_percent: Number
    inertia_percent: Value
    inertia_error: Number
    smallest_effort: Number
    smallest_force: Number | None


class AxisBenefit(Part):
    """Both models on one axis. `effort_rms`, `lines_rms`: of the measured effort itself, in the held-out sweeps.

    `lever_arm`: median over the held-out poses of the distance of the robot's end from the axis, m; null: prismatic.
    """

    unit: str
    training: tuple[str, ...]
    held_out: tuple[str, ...]
    poses: int
    held_out_poses: int
    effort_rms: Number
    lines_rms: Number
    lever_arm: Number | None
    cad: ModelBenefit
    identified: ModelBenefit

    @property
    def lines_ratio(self) -> float:
        """Factor by which the residual at the excited lines is smaller with the estimate."""
        return self.cad.lines_rms / self.identified.lines_rms

    @property
    def smallest_ratio(self) -> float:
        """Factor by which the smallest detectable effort is smaller with the estimate."""
        return self.cad.smallest_effort / self.identified.smallest_effort


class FollowingError(Part):
    """Error of an axis on a path, motor side, referred to the joint: rad (m)."""

    rms: Number
    peak: Number


class Tracking(Part):
    """The same path with torque feed-forward of each model, by joint. `top_speed`, `top_acceleration` of any joint."""

    duration: Number  # s
    top_speed: Number  # rad/s (m/s)
    top_acceleration: Number  # rad/s^2 (m/s^2)
    gain: Number  # 1/s, of the position controllers
    cad: Mapping[str, FollowingError]
    identified: Mapping[str, FollowingError]


class Benefit(Document):
    """By joint. `every`: every so-many-th pose of an axis is held out; `quiet_hours`: time per false alarm.

    `not_judged`: reasons why an axis has no result. `tracking`: result of a simulation, if there was one.
    """

    robot: str
    every: int
    quiet_hours: Number
    axes: Mapping[str, AxisBenefit]
    not_judged: Mapping[str, str]
    tracking: Tracking | None = None


@dataclass(frozen=True)
class _JudgedAxis:
    """One axis that can be compared; arrays are in the order of `held_out`."""

    robot: Robot
    number: int
    train: TwoMassTrain
    training: tuple[Sweep, ...]
    held_out: tuple[Sweep, ...]
    spectra: dict[str, Spectrum]
    measured: Array  # (h,) inertias
    covariance: Array  # (h, h)

    @property
    def poses(self) -> Array:
        """(h, joints)."""
        return np.array([sweep.spec.pose for sweep in self.held_out])

    def windows(self, sweeps: Sequence[Sweep]) -> list[Window]:
        bare = map(self.robot.without_counterbalance, sweeps)
        return [window_of(sweep, self.spectra[sweep.spec.id], self.number) for sweep in bare]


def benefit(robot: Robot, sweeps: Sequence[Sweep], place: str = "recordings") -> Benefit:
    """The comparison for all axes; BadInput if there is no sweep with lines, or a record is shorter than its sweep.

    `robot`: CAD. `sweeps`: in the order of measurement; those without lines are ignored.
    """
    used = [sweep for sweep in sweeps if sweep.spec.periodic and sweep.spec.shows_inertia]
    if not used:
        raise BadInput(
            place,
            "has no sweep of one axis with offset and sines, so none can be held out: measure some (`sweepid plan`)",
        )
    spectra = {sweep.spec.id: spectrum(robot, sweep) for sweep in used}
    joints = [joint for joint in robot.joints if any(sweep.spec.axis == joint for sweep in used)]
    poses = {
        joint: poses_of([sweep.spec for sweep in used if sweep.spec.axis == joint], robot.index(joint))
        for joint in joints
    }
    reasons = {joint: why for joint in joints if (why := _not_judged(robot, joint, len(poses[joint])))}
    judged = [joint for joint in joints if joint not in reasons]
    out = frozenset[str]().union(*(held_out(poses[joint]) for joint in judged))
    axes: dict[str, AxisBenefit] = {}
    if judged:
        every = identify(robot, list(spectra.values()))
        known = identify(robot, [one for id, one in spectra.items() if id not in out])
        if known.unlocked != every.unlocked:
            raise BadInput(place, "has a joint whose position differs only in held-out poses; measure it in more poses")
        parameters = standard_parameters(known).parameters
        for joint in judged:
            axis = _axis(robot, joint, used, spectra, out, known, every)
            counts = (len(poses[joint]), len(poses[joint]) // EVERY)
            axes[joint] = _judge(axis, known, parameters, counts)
    return Benefit(robot=robot.name, every=EVERY, quiet_hours=QUIET_HOURS, axes=axes, not_judged=reasons)


def _not_judged(robot: Robot, joint: str, poses: int) -> str | None:
    if poses < EVERY:
        return f"has sweeps in {poses} poses; every {EVERY}th is held out, so {EVERY} are needed"
    if robot.axis(joint).motor_inertia is None:
        return "the robot file has no motor_inertia, so the inertia of the CAD model is not known"
    return None


def _axis(
    robot: Robot,
    joint: str,
    used: Sequence[Sweep],
    spectra: dict[str, Spectrum],
    out: frozenset[str],
    known: RobotEstimate,
    every: RobotEstimate,
) -> _JudgedAxis:
    own = [sweep for sweep in used if sweep.spec.axis == joint]
    held = tuple(sweep for sweep in own if sweep.spec.id in out)
    all_of_it = _of(every, joint)
    place = {sweep.sweep: k for k, sweep in enumerate(all_of_it.sweeps)}
    rows = [place[sweep.spec.id] for sweep in held]
    fit = _of(known, joint).fit
    if fit is None:
        raise ValueError(f"{joint} has sweeps with lines, but no joint fit")
    return _JudgedAxis(
        robot=robot,
        number=robot.index(joint),
        train=fit.train,
        training=tuple(sweep for sweep in own if sweep.spec.id not in out),
        held_out=held,
        spectra=spectra,
        measured=all_of_it.values[rows],
        covariance=all_of_it.covariance[np.ix_(rows, rows)],
    )


def _of(estimate: RobotEstimate, joint: str) -> AxisEstimate:
    return next(axis for axis in estimate.axes if axis.joint == joint)


def _judge(axis: _JudgedAxis, known: RobotEstimate, identified: Array, counts: tuple[int, int]) -> AxisBenefit:
    """`identified` (11 n,): standard parameters. `counts`: poses, and those held out."""
    robot = axis.robot
    motors = [one.reflected_motor_inertia or 0.0 for one in robot.axes]
    nominal = np.concatenate([robot.chain.inertial.ravel(), motors])
    windows = axis.windows(axis.held_out)
    arm = None
    if robot.chain.joints[axis.number].kind == "revolute":
        arm = float(np.median(lever_arm(robot, axis.number, axis.poses)))
    rows = known.base.rows(known.chain, known.unlocked.index(axis.number), axis.poses[:, list(known.unlocked)])
    uncertain = rows @ known.solution.covariance @ rows.T
    return AxisBenefit(
        unit="N" if arm is None else "N m",
        training=tuple(sweep.spec.id for sweep in axis.training),
        held_out=tuple(sweep.spec.id for sweep in axis.held_out),
        poses=counts[0],
        held_out_poses=counts[1],
        effort_rms=_rms([float(np.mean(one.effort**2)) for one in windows]),
        lines_rms=_lines_rms(windows, [one.effort for one in windows]),
        lever_arm=arm,
        cad=_model(axis, nominal, axis.covariance, arm),
        identified=_model(axis, identified, axis.covariance + uncertain, arm),
    )


def _model(axis: _JudgedAxis, parameters: Array, covariance: Array, arm: float | None) -> ModelBenefit:
    """Result of the model with standard `parameters` (11 n,); `covariance` (h, h) of model minus measured inertia."""
    train_windows, windows = axis.windows(axis.training), axis.windows(axis.held_out)
    bodies = _bodies(axis, parameters, axis.training)
    before = [left_by(body, axis.train, one) for body, one in zip(bodies, train_windows, strict=True)]
    friction = dry_friction(before, train_windows)
    own = _bodies(axis, parameters, axis.held_out)
    left = [
        without_friction(left_by(body, axis.train, one), one, friction) for body, one in zip(own, windows, strict=True)
    ]
    peak = max(float(np.abs(one).max()) for one in left)
    rate = max(sweep.spec.sample_rate for sweep in axis.held_out)
    smallest = smallest_effort(
        np.array([one.mean() for one in left]), np.array([one.std() for one in left]), peak, alarm_probability(rate)
    )
    lines = _lines_rms(windows, left)
    error = np.array([body.inertia for body in own]) - axis.measured
    percent = 100 / axis.measured
    return ModelBenefit(
        effort_rms=_rms([float(np.mean(one**2)) for one in left]),
        effort_peak=peak,
        lines_rms=lines,
        left_percent=100 * lines / _lines_rms(windows, [one.effort for one in windows]),
        inertia_percent=rms_with_std(error * percent, covariance * np.outer(percent, percent), "%"),
        inertia_error=float(np.sqrt(np.mean(error**2))),
        smallest_effort=smallest,
        smallest_force=smallest if arm is None else smallest / arm if arm > ON_THE_AXIS else None,
    )


def rms_with_std(errors: Array, covariance: Array, unit: str) -> Value:
    """RMS r of errors e (n,) with covariance C (n, n), and its standard deviation sqrt(e' C e) / (n r)."""
    rms = float(np.sqrt(np.mean(errors**2)))
    std = float(np.sqrt(errors @ covariance @ errors)) / (len(errors) * rms) if rms else None
    return Value(value=rms, std=std, unit=unit)


def _bodies(axis: _JudgedAxis, parameters: Array, sweeps: Sequence[Sweep]) -> list[RigidAxis]:
    """The rigid body of the axis in the sweeps' poses, from `parameters` (11 n,) of the whole robot."""
    poses = np.array([sweep.spec.pose for sweep in sweeps])
    chain = axis.robot.chain
    inertia = axis_rows(chain, axis.number, poses) @ parameters
    gravity = gravity_terms(chain, parameters, axis.robot.gravity, axis.number, poses)
    return [RigidAxis(float(j), float(g), float(k)) for j, (g, k) in zip(inertia, gravity, strict=True)]


def _lines_rms(windows: Sequence[Window], signals: Sequence[Array]) -> float:
    return _rms([lines_power(signal, one) for signal, one in zip(signals, windows, strict=True)])


def _rms(powers: Sequence[float]) -> float:
    """RMS over sweeps with equal weights."""
    return float(np.sqrt(np.mean(powers)))


def poses_of(specs: Sequence[SweepSpec], own: int) -> list[list[SweepSpec]]:
    """The sweeps of joint number `own`, grouped by pose, in the order in which the poses first occur."""
    found: list[list[SweepSpec]] = []
    for spec in specs:
        same = next((pose for pose in found if _same(pose[0], spec, own)), None)
        if same is None:
            found.append([spec])
        else:
            same.append(spec)
    return found


def held_out(poses: Sequence[Sequence[SweepSpec]]) -> frozenset[str]:
    """The ids of the sweeps of every `EVERY`th pose."""
    return frozenset(spec.id for pose in poses[EVERY - 1 :: EVERY] for spec in pose)


def _same(one: SweepSpec, other: SweepSpec, own: int) -> bool:
    apart: Array = np.abs(np.subtract(one.pose, other.pose))
    limit = np.full(len(apart), 2e-3)  # rad (m) of the other joints, as of an estimate
    limit[own] = 0.1  # rad (m): a sweep travels about 4 degrees, forward or backward
    return bool(np.all(apart < limit))


def end_of(robot: Robot) -> Array:
    """Origin (3,) of the last link in the frame of the last moving one, along fixed joints to their end, for example a
    flange or tool.
    """
    joints = ET.fromstring(robot.urdf_text).findall("joint")
    fixed = {joint_end(joint, "parent", "urdf"): joint for joint in joints if joint.get("type") == "fixed"}
    link = robot.chain.joints[-1].link
    rotation, place = np.eye(3), np.zeros(3)
    while link in fixed:
        joint = fixed[link]
        link = joint_end(joint, "child", "urdf")
        turn, way = read_origin(joint, f"joint {joint.get('name')}")
        place = place + rotation @ way
        rotation = rotation @ turn
    return place


def lever_arm(robot: Robot, own: int, poses: Array) -> Array:
    """Distance (m,) in m between the robot's end and the line of revolute joint number `own`, at poses (m, joints)."""
    rotations, origins = link_frames(robot.chain, poses)
    end = origins[:, -1] + rotations[:, -1] @ end_of(robot)
    axis = rotations[:, own] @ robot.chain.joints[own].axis
    return np.linalg.norm(np.cross(axis, end - origins[:, own]), axis=-1)


def alarm_probability(sample_rate: float, quiet_hours: float = QUIET_HOURS) -> float:
    """Probability per sample for one false alarm in `quiet_hours`; `sample_rate` in Hz."""
    return 1.0 / (3600.0 * quiet_hours * sample_rate)


def smallest_effort(means: Array, stds: Array, peak: float, probability: float) -> float:
    """L from means (s,) and standard deviations (s,) of the sweeps and the largest difference recorded; N m (N)."""
    scale = max(float(np.abs(means).max()), float(stds.max()))
    if scale == 0:
        return peak
    spread = np.maximum(stds, 1e-9 * scale)

    def excess(limit: float) -> float:
        tails = ndtr(-(limit - means) / spread) + ndtr(-(limit + means) / spread)
        return float(np.mean(tails)) - probability

    # each sweep alone meets the rate here, so all together do
    enough = float(np.max(np.abs(means) - ndtri(probability / 2) * spread))
    return max(float(brentq(excess, 0.0, 1.01 * enough)), peak)
