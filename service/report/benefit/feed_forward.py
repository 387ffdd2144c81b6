r"""A path at working speed, and the feed-forward torque of each model along it.

The path leads from the first measured pose towards the most distant one, all axes at the same time, on

    s = 10 u^3 - 15 u^4 + 6 u^5,   u = t / T,   peak speed 15/8 D/T,

T follows from the joints' speed limits. No axis moves more than `WAY`, so that the motion is as fast as usual for a
robot; a measured axis whose pose never varied moves half of it. Effort is the rigid inverse dynamics of the model
(`inverse_dynamics`) with the friction of the estimate, the same for both: viscous from the drive train, dry from the
means of the sweeps. No sweep contains such a motion: it is an extrapolation from slow sweeps.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.identification.estimates.estimate import RobotEstimate, identify
from service.identification.estimates.standard_parameters import standard_parameters
from service.identification.model.inverse_dynamics import JointMotion, dynamics_rows
from service.identification.model.regressor import axis_rows, gravity_terms
from service.identification.spectra.frequency_response import Spectrum, spectrum
from service.model.errors import BadInput
from service.model.recording import Sweep
from service.model.robot import Robot
from service.report.benefit.prediction import RigidBody, left_by, window_of

Array = NDArray[np.float64]

CYCLE = 1e-3  # s
REST = 0.2  # s at rest before and after
SPEED = 0.6  # of the joints' speed limits
WAY = 0.8  # rad (m), at most
SAME_POSITION = 2e-3  # rad (m)


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
    """Path from one pose (joints,) to another at `SPEED` of the speed `limits` of the joints, rad/s (m/s)."""
    way = end - start
    duration = 15 / 8 * float(np.max(np.abs(way) / (SPEED * np.array(limits))))
    count = max(2, round(duration / CYCLE))
    u, taken = np.arange(count + 1) / count, count * CYCLE
    rest = np.zeros(round(REST / CYCLE))
    place = np.concatenate([rest, 10 * u**3 - 15 * u**4 + 6 * u**5, rest + 1])
    speed = np.concatenate([rest, (30 * u**2 - 60 * u**3 + 30 * u**4) / taken, rest])
    gain = np.concatenate([rest, (60 * u - 180 * u**2 + 120 * u**3) / taken**2, rest])
    return JointMotion(start + place[:, None] * way, speed[:, None] * way, gain[:, None] * way)


def _ends(robot: Robot, poses: Array, moved: Sequence[int]) -> tuple[Array, Array]:
    """Two poses (joints,): the first, and one on the way to the most distant from it, within the joints' limits."""
    start = poses[0].copy()
    end = poses[int(np.argmax(np.linalg.norm(poses - start, axis=1)))].copy()
    end = start + (end - start) * min(1.0, WAY / max(float(np.abs(end - start).max()), SAME_POSITION))
    for number in moved:
        joint = robot.chain.joints[number]
        if abs(end[number] - start[number]) < SAME_POSITION:
            away = WAY / 2 if start[number] + WAY / 2 <= joint.upper else -WAY / 2
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
            means.append(float(left_by(RigidBody(float(j), float(g), float(k)), axis.fit.train, window).mean()))
            signs.append(float(np.sign(window.velocity).mean()))
        friction[0, number] = axis.fit.train.motor_friction + axis.fit.train.load_friction
        friction[1, number] = np.dot(signs, means) / np.dot(signs, signs)
    return friction.ravel()
