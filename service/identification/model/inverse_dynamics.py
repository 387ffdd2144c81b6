r"""The effort of all axes, linear in the parameters of the robot and its drives.

Body i moves with angular velocity w, angular acceleration dw and its frame's origin with acceleration a minus gravity
(a - g), all expressed in its own frame. Newton and Euler give the required wrench at that origin,

    f = m a + dw x mc + w x (w x mc),     n = mc x a + I dw + w x I w          (Atkeson, An and Hollerbach 1986)

and joint k <= i provides  f.v + n.w  of it, with (v, w) the twist of body i if only joint k moves at unit speed (as in
`regressor`). The drive adds  Jm dv + Fv v + Fc sign(v) + offset  of its own motor.

The parameter vector is [ten parameters of link 1, ..., ten of link n, then n each of Jm, Fv, Fc, offset], (14 n,);
its first 11 n are those of `regressor`, Jm being reflected to the joint.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.identification.model.regressor import parameter_names
from service.model.robot import link_frames
from service.model.urdf import Chain

Array = NDArray[np.float64]

DRIVE = 4  # parameters of a drive: Jm, Fv, Fc, offset


@dataclass(frozen=True)
class Motion:
    """Motion of all joints at m instants: arrays (m, n); rad, rad/s, rad/s^2 (m, m/s, m/s^2)."""

    position: Array
    velocity: Array
    acceleration: Array


def dynamics_rows(chain: Chain, gravity: Array, load: Motion, motor: Motion | None = None) -> Array:
    """Rows (m, n, 14 n): ``rows @ parameters`` = effort of every axis, N m (N).

    `load` is the motion of the links, `motor` that of the motors on the joint side if it differs.
    """
    return np.concatenate([link_rows(chain, gravity, load), drive_rows(load if motor is None else motor)], axis=-1)


def drive_rows(motion: Motion) -> Array:
    """Rows (m, n, 4 n) of the drives' own parameters: Jm, Fv, Fc, offset of every axis."""
    each = (motion.acceleration, motion.velocity, np.sign(motion.velocity), np.ones_like(motion.velocity))
    return np.concatenate([part[..., None] * np.eye(part.shape[-1]) for part in each], axis=-1)


def link_rows(chain: Chain, gravity: Array, motion: Motion) -> Array:
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
        force, moment = _wrench_rows(*(_apply(to_body, vector) for vector in (spin, spin_rate, acceleration)))
        for k in range(body + 1):
            pull = _apply(to_body, axes[:, k])
            if chain.joints[k].kind == "prismatic":
                rows[:, k, body] = np.einsum("mi,mij->mj", pull, force)
                continue
            sway = _apply(to_body, np.cross(axes[:, k], origins[:, body] - origins[:, k]))
            rows[:, k, body] = np.einsum("mi,mij->mj", sway, force) + np.einsum("mi,mij->mj", pull, moment)
    return rows.reshape(samples, count, 10 * count)


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


def _apply(matrices: Array, vectors: Array) -> Array:
    return np.einsum("mij,mj->mi", matrices, vectors)
