r"""Rows that are linear in the inertial parameters: the inertia about an axis and the gravity torque on it.

If only joint k moves, at unit speed, body i >= k moves with the twist (v, w), expressed in its own frame i,

    w = R_i^T z_k,   v = R_i^T (z_k x (p_i - p_k))      (revolute)        w = 0,  v = R_i^T z_k      (prismatic)

and twice its kinetic energy is its share of the axis inertia (the paper's equation (4)):

    J_k(q) = sum_i  m v.v + 2 mc.(v x w) + w^T I w   + u_k^2 Jm_k

The parameter vector is [ten parameters of link 1, ..., ten of link n, u_1^2 Jm_1, ..., u_n^2 Jm_n], (11 n,).
Joints that never move in a campaign are removed first (`lock`), as in the paper for the last three axes.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from service.model import INERTIAL_NAMES, Array, Chain, Joint, Robot, link_frames, rotation_about, transform_inertial


def inertia_rows(chain: Chain, joint: int, poses: Array) -> Array:
    """Rows (m, 10 n) with ``rows @ link parameters`` = inertia of the links about axis `joint`, kg m^2 (kg)."""
    poses = np.atleast_2d(poses)
    rotations, origins = link_frames(chain, poses)
    count = len(chain.joints)
    axis = rotations[:, joint] @ chain.joints[joint].axis
    rows = np.zeros((len(poses), count, 10))
    for body in range(joint, count):
        to_body = np.swapaxes(rotations[:, body], -1, -2)
        if chain.joints[joint].kind == "prismatic":
            v, w = apply_each(to_body, axis), np.zeros_like(axis)
        else:
            v = apply_each(to_body, np.cross(axis, origins[:, body] - origins[:, joint]))
            w = apply_each(to_body, axis)
        wx, wy, wz = w.T
        rows[:, body, 0] = np.sum(v * v, -1)
        rows[:, body, 1:4] = 2 * np.cross(v, w)
        rows[:, body, 4:10] = np.stack([wx * wx, 2 * wx * wy, wy * wy, 2 * wx * wz, 2 * wy * wz, wz * wz], -1)
    return rows.reshape(len(poses), 10 * count)


def axis_rows(chain: Chain, joint: int, poses: Array) -> Array:
    """Rows (m, 11 n) of the whole parameter vector: links, then reflected motor inertias."""
    links = inertia_rows(chain, joint, poses)
    motors = np.zeros((len(links), len(chain.joints)))
    motors[:, joint] = 1.0
    return np.hstack([links, motors])


def gravity_terms(chain: Chain, parameters: Array, gravity: Array, joint: int, poses: Array) -> Array:
    """(m, 2): [torque, stiffness] of gravity about axis `joint` at each pose, N m and N m/rad.

    Turned by d from the pose, the axis needs ``torque cos d + stiffness sin d``: with S the first moment of all that
    hangs on the axis, taken from its origin, torque = -g.(z x S), stiffness = -g.(z x (z x S)). Zero for prismatic
    axes, whose gravity force does not change along the way.
    """
    poses = np.atleast_2d(poses)
    if chain.joints[joint].kind == "prismatic":
        return np.zeros((len(poses), 2))
    links = parameters[: 10 * len(chain.joints)].reshape(-1, 10)
    rotations, origins = link_frames(chain, poses)
    axis = rotations[:, joint] @ chain.joints[joint].axis
    moment = np.zeros_like(axis)
    for body in range(joint, len(chain.joints)):
        arm = origins[:, body] - origins[:, joint]
        moment += links[body, 0] * arm + rotations[:, body] @ links[body, 1:4]
    turned = np.cross(axis, moment)
    return np.stack([-turned @ gravity, -np.cross(axis, turned) @ gravity], -1)


def counterbalance_terms(robot: Robot, joint: int, poses: Array) -> Array:
    """(m, 2): [torque, stiffness] of a counterbalance of axis `joint` at each pose, as `gravity_terms`."""
    nudge = 1e-4  # rad
    at = np.atleast_2d(poses)[:, joint]
    before, here, after = (robot.counterbalance_effort(joint, at + away) for away in (-nudge, 0.0, nudge))
    return np.stack([here, (after - before) / (2 * nudge)], -1)


def gravity_rows(chain: Chain, gravity: Array, joint: int, poses: Array) -> Array:
    """(m, 2, 10 n) with ``rows @ link parameters`` = [torque, stiffness] as `gravity_terms`; a prismatic axis has the
    force -g.z of its load, N, and no stiffness.
    """
    poses = np.atleast_2d(poses)
    rotations, origins = link_frames(chain, poses)
    count = len(chain.joints)
    axis = rotations[:, joint] @ chain.joints[joint].axis
    rows = np.zeros((len(poses), 2, count, 10))
    prismatic = chain.joints[joint].kind == "prismatic"
    # -g.(z x S) = S.(z x g) and -g.(z x (z x S)) = -S.(z x (z x g)), S the first moment
    across = np.cross(axis, gravity)
    along = -np.cross(axis, across)
    for body in range(joint, count):
        if prismatic:
            rows[:, 0, body, 0] = -axis @ gravity
            continue
        arm = origins[:, body] - origins[:, joint]
        for part, direction in enumerate((across, along)):
            rows[:, part, body, 0] = np.sum(arm * direction, -1)
            rows[:, part, body, 1:4] = apply_each(np.swapaxes(rotations[:, body], -1, -2), direction)
    return rows.reshape(len(poses), 2, -1)


SAME_POSITION = 2e-3  # rad (m): positions that differ by less are one; a joint that did not move more was locked


def lock(chain: Chain, fixed: dict[int, float]) -> Chain:
    """The chain with the joints of `fixed` locked at the given positions, and their links merged into the previous one.

    Links before the first remaining joint belong to the base and are removed. The result has one link per remaining
    joint.
    """
    joints: list[Joint] = []
    inertial: list[Array] = []
    for k, keeper, rotation, translation in _carried(chain, fixed):
        if k not in fixed:
            joints.append(replace(chain.joints[k], rotation=rotation, translation=translation))
            inertial.append(chain.inertial[k])
        elif keeper >= 0:
            inertial[keeper] = inertial[keeper] + transform_inertial(chain.inertial[k], rotation, translation)
    return Chain(tuple(joints), np.array(inertial).reshape(-1, 10))


def fold(chain: Chain, fixed: dict[int, float]) -> Array:
    """(11 u, 11 n): the effect of `lock` on any parameters: ``fold @ parameters`` are those of the u remaining
    joints.
    """
    count = len(chain.joints)
    left = [k for k in range(count) if k not in fixed]
    links = np.zeros((len(left), 10, count, 10))
    for k, keeper, rotation, translation in _carried(chain, fixed):
        if k not in fixed:
            links[left.index(k), :, k] = np.eye(10)
        elif keeper >= 0:
            links[keeper, :, k] = np.stack([transform_inertial(unit, rotation, translation) for unit in np.eye(10)], -1)
    matrix = np.zeros((11 * len(left), 11 * count))
    matrix[: 10 * len(left), : 10 * count] = links.reshape(10 * len(left), 10 * count)
    matrix[10 * len(left) :, 10 * count :] = np.eye(count)[left]
    return matrix


def inertial_parameters(robot: Robot, chain: Chain | None = None, joints: Sequence[int] | None = None) -> Array:
    """The model's parameters (11 n,) of all joints, or of a `chain` of the robot's `joints`; an unknown motor has 0."""
    axes = robot.axes if joints is None else [robot.axes[number] for number in joints]
    motors = [axis.reflected_motor_inertia or 0.0 for axis in axes]
    return np.concatenate([(chain or robot.chain).inertial.ravel(), motors])


def parameter_names(chain: Chain) -> tuple[str, ...]:
    """Names of the 11 n parameters: ``Izz(link_2)``, ..., ``Jm(joint_2)``; a merged body has the name of its first
    link.
    """
    links = [f"{name}({joint.link})" for joint in chain.joints for name in INERTIAL_NAMES]
    return (*links, *(f"Jm({joint.name})" for joint in chain.joints))


def apply_each(matrices: Array, vectors: Array) -> Array:
    """Matrices (m, i, j) on vectors (m, j)."""
    return np.einsum("mij,mj->mi", matrices, vectors)


def _carried(chain: Chain, fixed: dict[int, float]) -> Iterator[tuple[int, int, Array, Array]]:
    """For each joint its number, the number of the last remaining joint before it (among the remaining ones; -1: none),
    and the pose (R, t) of its frame in that frame, with fixed joints at their positions.
    """
    keeper, rotation, translation = -1, np.eye(3), np.zeros(3)
    for k, joint in enumerate(chain.joints):
        translation = translation + rotation @ joint.translation
        rotation = rotation @ joint.rotation
        if k not in fixed:
            yield k, keeper, rotation, translation
            keeper, rotation, translation = keeper + 1, np.eye(3), np.zeros(3)
            continue
        if joint.kind == "prismatic":
            translation = translation + rotation @ joint.axis * fixed[k]
        else:
            rotation = rotation @ rotation_about(joint.axis, np.asarray(fixed[k]))
        yield k, keeper, rotation, translation
