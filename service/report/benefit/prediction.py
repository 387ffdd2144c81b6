"""The effort that a rigid-body model predicts in a sweep, and the residual of the measured effort.

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

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.identification.axis.drive_train import TwoMassTrain, impedance
from service.identification.estimates.estimate import RobotEstimate, identify
from service.identification.estimates.standard_parameters import standard_parameters
from service.identification.model.inverse_dynamics import JointMotion, dynamics_rows
from service.identification.model.regressor import axis_rows, gravity_terms
from service.identification.spectra.frequency_response import Spectrum, spectrum, window
from service.model.arrays import Array
from service.model.errors import BadInput
from service.model.recording import Sweep
from service.model.robot import Robot


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
    bins: NDArray[np.int_]
    frequency: Array  # (b,) Hz
    speed: NDArray[np.complex128]


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
    cad, own = (rows @ np.concatenate([parameters, friction]) for parameters in (nominal, identified))
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
            window = window_of(sweep, spectra[sweep.spec.id], number)
            means.append(float(left_by(RigidAxis(float(j), float(g), float(k)), axis.fit.train, window).mean()))
            signs.append(float(np.sign(window.velocity).mean()))
        friction[0, number] = axis.fit.train.motor_friction + axis.fit.train.load_friction
        friction[1, number] = np.dot(signs, means) / np.dot(signs, signs)
    return friction.ravel()
