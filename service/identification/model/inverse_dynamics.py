r"""The effort of all axes, linear in the parameters of the robot and its drives.

Body i moves with angular velocity w, angular acceleration dw and its frame's origin with acceleration a minus gravity
(a - g), all expressed in its own frame. Newton and Euler give the required wrench at that origin,

    f = m a + dw x mc + w x (w x mc),     n = mc x a + I dw + w x I w          (Atkeson, An and Hollerbach 1986)

and joint k <= i provides  f.v + n.w  of it, with (v, w) the twist of body i if only joint k moves at unit speed (as in
`regressor`). The drive adds  Jm dv + Fv v + Fc sign(v) + offset  of its own motor.

The parameter vector is [ten parameters of link 1, ..., ten of link n, then n each of Jm, Fv, Fc, offset], (14 n,);
its first 11 n are those of `regressor`, Jm being reflected to the joint.

The nominal model of the whole dynamics, (14 n,) parameters as in `inverse_dynamics`, and its uncertainty.

What no data sheet gives may be anything that the measured efforts allow: an unknown rotor behind its gear can be 500
times as heavy as the wrist that it turns, so the model of the links says nothing about it (`Scale`).
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from service.identification.model.base_parameters import BaseParameters, joint_ranges, reduce_columns
from service.identification.model.least_squares import Information
from service.identification.model.regressor import apply_each, inertia_rows, inertial_parameters, parameter_names
from service.model import Array, Chain, Robot, link_frames


@dataclass(frozen=True)
class JointMotion:
    """Motion of all joints at m instants: arrays (m, n); rad, rad/s, rad/s^2 (m, m/s, m/s^2)."""

    position: Array
    velocity: Array
    acceleration: Array


def dynamics_rows(chain: Chain, gravity: Array, load: JointMotion, motor: JointMotion | None = None) -> Array:
    """Rows (m, n, 14 n): ``rows @ parameters`` = effort of every axis, N m (N).

    `load` is the motion of the links, `motor` that of the motors on the joint side if it differs.
    """
    return np.concatenate([link_rows(chain, gravity, load), drive_rows(load if motor is None else motor)], axis=-1)


def drive_rows(motion: JointMotion) -> Array:
    """Rows (m, n, 4 n) of the drives' own parameters: Jm, Fv, Fc, offset of every axis."""
    each = (motion.acceleration, motion.velocity, np.sign(motion.velocity), np.ones_like(motion.velocity))
    return np.concatenate([part[..., None] * np.eye(part.shape[-1]) for part in each], axis=-1)


def link_rows(chain: Chain, gravity: Array, motion: JointMotion) -> Array:
    """Rows (m, n, 10 n) of the links' inertial parameters; `gravity` (3,) in the base frame, m/s^2."""
    count, samples = len(chain.joints), len(motion.position)
    rotations, origins = link_frames(chain, motion.position)
    axes = np.stack([rotations[:, k] @ joint.axis for k, joint in enumerate(chain.joints)], axis=1)
    rows = np.zeros((samples, count, count, 10))
    spin, spin_rate = np.zeros((2, samples, 3))
    acceleration = np.tile(-gravity, (samples, 1))
    before = np.zeros((samples, 3))
    for body, joint in enumerate(chain.joints):
        axis = axes[:, body]
        speed, gain = motion.velocity[:, body, None], motion.acceleration[:, body, None]
        arm = origins[:, body] - before
        acceleration = acceleration + np.cross(spin_rate, arm) + np.cross(spin, np.cross(spin, arm))
        if joint.kind == "prismatic":
            acceleration = acceleration + 2 * speed * np.cross(spin, axis) + gain * axis
        else:
            spin_rate = spin_rate + gain * axis + speed * np.cross(spin, axis)
            spin = spin + speed * axis
        before = origins[:, body]
        to_body = np.swapaxes(rotations[:, body], -1, -2)
        force, moment = _wrench_rows(*(apply_each(to_body, vector) for vector in (spin, spin_rate, acceleration)))
        for k in range(body + 1):
            pull = apply_each(to_body, axes[:, k])
            if chain.joints[k].kind == "prismatic":
                rows[:, k, body] = np.einsum("mi,mij->mj", pull, force)
                continue
            sway = apply_each(to_body, np.cross(axes[:, k], origins[:, body] - origins[:, k]))
            rows[:, k, body] = np.einsum("mi,mij->mj", sway, force) + np.einsum("mi,mij->mj", pull, moment)
    return rows.reshape(samples, count, 10 * count)


def coupling_rows(chain: Chain, pairs: Sequence[tuple[int, int]], poses: Array) -> Array:
    """Rows (m, pairs, 11 n) of the off-diagonal inertias M_kj(q) at poses (m, n), kg m^2 (kg, kg m)."""
    rows, still = np.zeros((len(poses), len(pairs), 11 * len(chain.joints))), np.zeros_like(poses)
    for number, (k, j) in enumerate(pairs):
        motion = JointMotion(poses, still, still + np.eye(len(chain.joints))[j])
        rows[:, number, : 10 * len(chain.joints)] = link_rows(chain, np.zeros(3), motion)[:, k]
    return rows


def dynamics_names(chain: Chain) -> tuple[str, ...]:
    """Names of the 14 n parameters: those of `parameter_names`, then ``Fv(joint_1)``, ``Fc(...)``, ``offset(...)``."""
    drives = [f"{name}({joint.name})" for name in ("Fv", "Fc", "offset") for joint in chain.joints]
    return (*parameter_names(chain), *drives)


def _wrench_rows(spin: Array, spin_rate: Array, acceleration: Array) -> tuple[Array, Array]:
    """Force and moment at a body's origin as rows (m, 3, 10) of its ten parameters; vectors (m, 3) in its frame."""
    force, moment = np.zeros((2, len(spin), 3, 10))
    force[:, :, 0] = acceleration
    force[:, :, 1:4] = _cross(spin_rate) + _cross(spin) @ _cross(spin)
    moment[:, :, 1:4] = -_cross(acceleration)
    moment[:, :, 4:] = _momentum(spin_rate) + _cross(spin) @ _momentum(spin)
    return force, moment


def _cross(vector: Array) -> Array:
    """(m, 3) -> (m, 3, 3) with ``_cross(a) @ b`` = a x b."""
    x, y, z = vector.T
    zero = np.zeros_like(x)
    return np.stack([np.stack(row, -1) for row in ([zero, -z, y], [z, zero, -x], [-y, x, zero])], -2)


def _momentum(spin: Array) -> Array:
    """(m, 3) -> (m, 3, 6) with ``_momentum(w) @ [Ixx, Ixy, Iyy, Ixz, Iyz, Izz]`` = I w."""
    x, y, z = spin.T
    zero = np.zeros_like(x)
    rows = ([x, y, zero, z, zero, zero], [zero, x, y, zero, z, zero], [zero, zero, zero, x, y, z])
    return np.stack([np.stack(row, -1) for row in rows], -2)


SAMPLES = 200  # random motions that represent all motions


def dynamic_base(robot: Robot, ends: tuple[Array, Array] | None = None, apart: Collection[str] = ()) -> BaseParameters:
    """The base parameters of the efforts of all axes that move, including friction and offsets; columns of the 14 n.

    `ends`: lower and upper (n,) positions of the joints, rad (m); a joint with equal ends stands. None: the whole
    range of every joint. `apart`: joints whose load is measured beside the motor, so that the rotor is told from the
    link that it turns.
    """
    rng = np.random.default_rng(0)
    lower, upper = ends or joint_ranges(robot.chain)
    moving, shape = lower < upper, (SAMPLES, len(lower))
    motion = JointMotion(rng.uniform(lower, upper, shape), *(moving * rng.uniform(-1.0, 1.0, (2, *shape))))
    swings = [joint in apart for joint in robot.joints] * rng.uniform(-1.0, 1.0, shape)
    motor = JointMotion(motion.position, motion.velocity, motion.acceleration + swings)
    rows = dynamics_rows(robot.chain, robot.gravity, motion, motor)[:, moving]
    return reduce_columns(rows.reshape(-1, rows.shape[-1]), dynamics_names(robot.chain))


@dataclass(frozen=True)
class Scale:
    """Size of the measurements of an axis, all positive, and the largest values that they allow; None where nothing was
    measured.
    """

    inertia: float | None = None  # kg m^2 (kg)
    viscous: float | None = None  # N m s/rad (N s/m)
    effort: float | None = None  # N m (N), RMS
    speed: float | None = None  # rad/s (m/s), the highest


def nominal_parameters(robot: Robot) -> Array:
    """The model's (14 n,): links of CAD, motors and viscous friction of the data sheets; dry friction is unknown."""
    viscous = [axis.viscous_friction or 0.0 for axis in robot.axes]
    return np.concatenate([inertial_parameters(robot), viscous, np.zeros(2 * len(robot.axes))])


def link_sizes(links: Array, lightest: float = 0.0) -> Array:
    """Natural sizes (10 n,) of the parameters of links (n, 10): m, m r and m r^2 for mass, first and second moments.

    r: radius of gyration, m. `lightest`, kg: least mass.
    """
    # kg, and m below: no parameter is certain
    mass = np.maximum(links[:, :1], max(lightest, 1e-9))
    radius = np.sqrt(np.maximum(links[:, [4, 6, 9]].sum(-1, keepdims=True), 0) / 2 / mass) + 1e-3
    return np.hstack([mass, np.repeat(mass * radius, 3, 1), np.repeat(mass * radius**2, 6, 1)]).ravel()


def parameter_spread(robot: Robot, scales: Mapping[str, Scale] | None = None) -> Array:
    """Standard deviations (14 n,). For values without data sheet those of `scales`, by joint; where nothing was
    measured, the inertia that a motor moves, and the rated effort at the joint's highest speed.
    """
    size = link_sizes(robot.chain.inertial)
    prior = robot.prior
    measured = [(scales or {}).get(axis.joint, Scale()) for axis in robot.axes]
    # three times that of a measured motion in place of the rated effort
    rated = np.array(
        [3.0 * one.effort if one.effort else axis.rated_effort for axis, one in zip(robot.axes, measured, strict=True)]
    )
    motors = [
        prior.motor_inertia * axis.reflected_motor_inertia
        if axis.reflected_motor_inertia
        else measured[k].inertia or _moved(robot, k)
        for k, axis in enumerate(robot.axes)
    ]
    speeds = [
        joint.velocity if np.isfinite(joint.velocity) and joint.velocity > 0 else 1.0 for joint in robot.chain.joints
    ]
    viscous = [
        prior.viscous_friction * axis.viscous_friction
        if axis.viscous_friction
        else one.viscous or axis.rated_effort / speed
        for axis, speed, one in zip(robot.axes, speeds, measured, strict=True)
    ]
    # dry friction and offset are in no data sheet
    return np.concatenate([prior.inertia * size, motors, viscous, 0.1 * rated, 0.02 * rated])


def prior_information(robot: Robot, base: BaseParameters, scales: Mapping[str, Scale] | None = None) -> Information:
    """The prior of the base parameters (r,) as a measurement of them."""
    spread = parameter_spread(robot, scales)
    # dry friction has a wide prior; an offset too, unless a measured effort tells its size: else it and gravity share
    # what few poses show
    spread[12 * len(robot.axes) : 13 * len(robot.axes) if scales else None] *= 10.0
    covariance = (base.combination * spread**2) @ base.combination.T
    start = base.combination @ nominal_parameters(robot)
    return Information.empty(len(start)).add(np.eye(len(start)), start, covariance)


def _moved(robot: Robot, index: int) -> float:
    """Inertia of the links about an axis in the middle of all ranges, kg m^2 (kg)."""
    pose = np.mean(joint_ranges(robot.chain), axis=0)
    return float((inertia_rows(robot.chain, index, pose[None]) @ robot.chain.inertial.ravel())[0])
