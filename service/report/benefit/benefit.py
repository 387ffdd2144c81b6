"""CAD and estimate compared on sweeps that were not used in the estimate; see `held_out`, `prediction` and `monitor`.

The tested estimate uses the training sweeps of all axes and no held-out sweep. Its gravity is that of its physical
standard parameters: the part that the inertias do not determine is that of CAD. The measured inertia in a held-out pose
is that of an estimate from all sweeps, with its covariance.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.identification.axis.axis_estimate import AxisEstimate
from service.identification.axis.drive_train import TwoMassTrain
from service.identification.estimates.estimate import RobotEstimate, identify
from service.identification.estimates.standard_parameters import standard_parameters
from service.identification.model.regressor import axis_rows, gravity_terms
from service.identification.spectra.frequency_response import Spectrum, spectrum
from service.model.errors import BadInput
from service.model.recording import Sweep
from service.model.results.effect import Value
from service.model.robot import Robot
from service.report.benefit.held_out import EVERY, held_out, poses_of
from service.report.benefit.lever_arm import ON_THE_AXIS, lever_arm
from service.report.benefit.monitor import QUIET_HOURS, alarm_probability, smallest_effort
from service.report.benefit.prediction import (
    RigidBody,
    Window,
    dry_friction,
    left_by,
    lines_power,
    window_of,
    without_friction,
)
from service.report.benefit.result import AxisBenefit, Benefit, ModelBenefit

Array = NDArray[np.float64]


@dataclass(frozen=True)
class _Axis:
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
        return [window_of(sweep, self.spectra[sweep.spec.id], self.number) for sweep in sweeps]


def benefit(robot: Robot, sweeps: Sequence[Sweep], place: str = "recordings") -> Benefit:
    """The comparison for all axes; BadInput if there is no sweep with lines, or a record is shorter than its sweep.

    `robot`: CAD. `sweeps`: in the order of measurement; those without lines are ignored.
    """
    used = [sweep for sweep in sweeps if sweep.spec.periodic and sweep.spec.shows_inertia]
    if not used:
        raise BadInput(place, "has no sweep of one axis with offset and sines; nothing can be held out")
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
) -> _Axis:
    own = [sweep for sweep in used if sweep.spec.axis == joint]
    held = tuple(sweep for sweep in own if sweep.spec.id in out)
    all_of_it = _of(every, joint)
    place = {sweep.sweep: k for k, sweep in enumerate(all_of_it.sweeps)}
    rows = [place[sweep.spec.id] for sweep in held]
    fit = _of(known, joint).fit
    if fit is None:
        raise ValueError(f"{joint} has sweeps with lines, but no joint fit")
    return _Axis(
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


def _judge(axis: _Axis, known: RobotEstimate, identified: Array, counts: tuple[int, int]) -> AxisBenefit:
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
        lines_rms=_lines(windows, [one.effort for one in windows]),
        lever_arm=arm,
        cad=_model(axis, nominal, axis.covariance, arm),
        identified=_model(axis, identified, axis.covariance + uncertain, arm),
    )


def _model(axis: _Axis, parameters: Array, covariance: Array, arm: float | None) -> ModelBenefit:
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
        np.array([one.mean() for one in left]),
        np.array([one.std() for one in left]),
        peak,
        alarm_probability(rate),
    )
    lines = _lines(windows, left)
    error = np.array([body.inertia for body in own]) - axis.measured
    percent = 100 / axis.measured
    return ModelBenefit(
        effort_rms=_rms([float(np.mean(one**2)) for one in left]),
        effort_peak=peak,
        lines_rms=lines,
        left_percent=100 * lines / _lines(windows, [one.effort for one in windows]),
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


def _bodies(axis: _Axis, parameters: Array, sweeps: Sequence[Sweep]) -> list[RigidBody]:
    """The rigid body of the axis in the sweeps' poses, from `parameters` (11 n,) of the whole robot."""
    poses = np.array([sweep.spec.pose for sweep in sweeps])
    chain = axis.robot.chain
    inertia = axis_rows(chain, axis.number, poses) @ parameters
    gravity = gravity_terms(chain, parameters, axis.robot.gravity, axis.number, poses)
    return [RigidBody(float(j), float(g), float(k)) for j, (g, k) in zip(inertia, gravity, strict=True)]


def _lines(windows: Sequence[Window], signals: Sequence[Array]) -> float:
    return _rms([lines_power(signal, one) for signal, one in zip(signals, windows, strict=True)])


def _rms(powers: Sequence[float]) -> float:
    """RMS over sweeps with equal weights."""
    return float(np.sqrt(np.mean(powers)))
