r"""The rigid model of one axis: the torque of its links in the measured poses, and the uncertainty of CAD.

In pose p, at an angle d from it, the axis needs

    tau = J_p a + T_p cos d + S_p sin d          (revolute; prismatic: J_p a + T_p)

The *load* y = (J_p, T_p, S_p) of all poses is linear in the inertial parameters of the links, y = L phi, and so is its
deviation from CAD. It is reduced to a few columns that change the torque (the base parameters of these poses), with
coefficients z and

    y = y_nominal + Q z,      z ~ N(0, C)         C from the robot's prior, as pseudo-data

An effect that is a wrong load (gravity, payload, torque gain) adds no column of its own: it *frees* the directions that
it changes, so that the prior does not limit them. Its size is the part of them that exceeds the prior. A parallelogram
also has another L: the prior of its deviations from CAD is that of the linked robot.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.linalg import solve_triangular

from service.identification.model import axis_rows, counterbalance_terms, gravity_rows
from service.model import Array, Indices, Knowledge, Robot, transform_inertial

SLACK = 1e-5  # of the rated effort, one sigma: elastic links, inexact lengths in CAD
LEAST_MOMENT = 0.05  # m times the mass: smallest first moment to which the relative prior applies


@dataclass(frozen=True)
class Rigid:
    """Loads (3, m) of m poses: [inertia; torque at the pose; its slope]. `basis` (k, 3, m) are the columns of Q, each
    about 1 N m of torque, RMS; `precision` (k, k) is the prior's; `freed` holds, for each effect that is a wrong load,
    the directions (k, r) it frees; `linked` (k, k) is the prior's precision with a parallelogram.
    """

    nominal: Array
    basis: Array
    precision: Array
    freed: Mapping[str, Array]
    linked: Array

    def load(self, coefficients: Array) -> Array:
        """(3, m) for coefficients (k,)."""
        return self.nominal + np.tensordot(coefficients, self.basis, axes=1)

    def along(self, pose_index: Indices, parts: Array) -> Array:
        """The columns of the load (n, t, k) for signals (3, n, t) that multiply it, each sweep in its pose."""
        return np.einsum("bkn,knt->ntb", self.basis[:, :, pose_index], parts, optimize=True)

    def prior(self, effects: Sequence[str]) -> Array:
        """(k, k): the precision of the prior of a robot with these effects."""
        return self.linked if "parallelogram" in effects else self.precision

    def precision_without(self, effects: Sequence[str]) -> Array:
        """(k, k): the prior without the directions that these effects free."""
        free, prior = [self.freed[name] for name in effects if name in self.freed], self.prior(effects)
        if not free:
            return prior
        directions = np.concatenate(free, axis=1)
        held = prior @ directions
        inner = directions.T @ held
        return prior - held @ np.linalg.pinv(inner, rcond=1e-10, hermitian=True) @ held.T

    def freedom(self, effect: str) -> int:
        """Number of directions that an effect frees."""
        return self.freed[effect].shape[1] if effect in self.freed else 0


def rigid(robot: Robot, joint: str, poses: Array, sizes: Array) -> Rigid:
    """The rigid model of an axis in `poses` (m, n). `sizes` (3,): RMS of acceleration, cos d, sin d: weights of y."""
    index, rated = robot.index(joint), robot.axis(joint).rated_effort
    rows = load_rows(robot, index, poses)
    weight = np.repeat(sizes, len(poses))[:, None] / np.sqrt(len(poses))
    nominal = nominal_load(robot, joint, poses)
    carried = np.vstack([np.zeros(len(poses)), counterbalance_terms(robot, index, poses).T])
    gravity_alone = np.repeat([0.0, 1.0, 1.0], len(poses))[:, None]
    # 1e-3 rad, inclination of the base, one sigma
    tilts, spread = 1e-3 * _tilts(robot, index, poses), parameter_spread(robot, index, poses)
    linkages = parallelograms(robot, index, poses)
    prior = np.column_stack([rows @ spread, tilts])
    linked = np.column_stack([*(own @ spread for own in linkages.values()), tilts])
    moved = {
        "gravity_error": gravity_alone
        * np.column_stack(
            [rows @ _moments(robot), _tilts(robot, index, poses), rated * _by_own_angle(poses[:, index])]
        ),
        "payload": rows @ _payload(robot),
        "torque_constant_error": (nominal + carried).reshape(-1, 1),
        "parallelogram": changes(robot, rows, linkages),
    }
    spans = {name: weight * columns * _unit(weight * columns, rated) for name, columns in moved.items()}
    vectors, values, _ = np.linalg.svd(
        np.column_stack([weight * prior, weight * linked, *spans.values()]), full_matrices=False
    )
    kept = values > SLACK * rated
    turn = vectors[:, kept]  # (3 m, k)
    inverse = np.divide(1.0, weight, out=np.zeros_like(weight), where=weight > 0)

    def precision(spread: Array) -> Array:
        root = turn.T @ (weight * spread)
        return _inverse(root @ root.T, (SLACK * rated) ** 2)

    return Rigid(
        nominal=nominal,
        basis=(inverse * turn).T.reshape(-1, 3, len(poses)),
        precision=precision(prior),
        linked=precision(linked),
        freed={name: directions for name, columns in spans.items() if (directions := _telling(turn.T @ columns)).size},
    )


def load_rows(robot: Robot, index: int, poses: Array) -> Array:
    """L (3 m, 11 n): inertias, gravity torques and their slopes in m poses, linear in the parameters of all links."""
    gravity = gravity_rows(robot.chain, robot.gravity, index, poses)
    motors = np.zeros((len(gravity), len(robot.joints)))
    torques, slopes = (np.hstack([gravity[:, part], motors]) for part in (0, 1))
    return np.vstack([axis_rows(robot.chain, index, poses), torques, slopes])


def nominal_load(robot: Robot, joint: str, poses: Array) -> Array:
    """Load (3, m) of CAD and data sheet."""
    return (load_rows(robot, robot.index(joint), poses) @ nominal_parameters(robot)).reshape(3, -1)


def nominal_parameters(robot: Robot) -> Array:
    """(11 n,): CAD's links, then the data sheets' reflected motor inertias."""
    motors = [axis.reflected_motor_inertia or 0.0 for axis in robot.axes]
    return np.concatenate([robot.chain.inertial.ravel(), motors])


def parallelograms(robot: Robot, index: int, poses: Array) -> dict[int, Array]:
    """`load_rows` (3 m, 11 n) of an axis with each possible parallelogram, by the number k of the joint at its one end.

    The drive of joint k + 1 then turns its link from before joint k, about a parallel axis: q_(k+1) = s_(k+1) - s_k
    with the positions s of the drives. While drive k alone turns, the links beyond keep their direction, so they act
    on it as their mass in the origin of joint k + 1; every other axis has the load of the pose q. A belt or a gear of
    ratio 1 from there does the same. Only those that change the load are given.
    """
    plain, found = load_rows(robot, index, poses), dict[int, Array]()
    for k, (own, following) in enumerate(pairwise(robot.chain.joints)):
        same = float(own.axis @ following.rotation @ following.axis)
        if {own.kind, following.kind} != {"revolute"} or abs(same) < 1 - 1e-6:
            continue
        turned = poses.copy()
        turned[:, k + 1] -= np.sign(same) * poses[:, k]
        rows = load_rows(robot, index, turned)
        if index == k:
            unit = transform_inertial(np.eye(10)[0], np.eye(3), following.translation)
            links = rows[:, : robot.chain.inertial.size].reshape(len(rows), -1, 10)
            links[:, k + 1 :] = 0.0
            links[:, k + 1 :, 0] = (links[:, k] @ unit)[:, None]
        if np.abs((rows - plain) @ nominal_parameters(robot)).max() > SLACK * robot.axes[index].rated_effort:
            found[k] = rows
    return found


def changes(robot: Robot, rows: Array, linkages: Mapping[int, Array]) -> Array:
    """(3 m, r): how the load of CAD changes with each parallelogram."""
    changes = [(own - rows) @ nominal_parameters(robot) for own in linkages.values()]
    return np.stack(changes, axis=-1) if changes else np.zeros((len(rows), 0))


def parameter_spread(robot: Robot, index: int, poses: Array) -> Array:
    """(11 n, 11 n): a root of the parameters' covariance. CAD errors are independent: masses and first moments have
    the prior of gravity, inertias and motors their own. The knowledge of an estimate makes the covariance smaller.
    """
    prior, inertial = robot.prior, robot.chain.inertial
    mass = np.abs(inertial[:, :1])
    moment = np.maximum(np.linalg.norm(inertial[:, 1:4], axis=1, keepdims=True), LEAST_MOMENT * mass)
    inertia = np.abs(inertial[:, [4, 6, 9]]).max(axis=1, keepdims=True)
    sigma = np.hstack(
        [prior.gravity * mass, prior.gravity * np.repeat(moment, 3, 1), prior.inertia * np.repeat(inertia, 6, 1)]
    )
    typical = float(np.max(axis_rows(robot.chain, index, poses)[:, : inertial.size] @ inertial.ravel()))
    # 0.5 of the axis' inertia: assumed motor inertia if the robot file has none
    motors = [
        0.5 * typical if u is None else prior.motor_inertia * u
        for u in (axis.reflected_motor_inertia for axis in robot.axes)
    ]
    return _informed(np.concatenate([sigma.ravel(), motors]), robot.knowledge)


def deviations_left(root: Array, rows: Array, covariance: Array, floor: float) -> Array:
    """Standard deviations (p,) of parameters with prior `root @ root.T` (p, p) after `rows` (m, p) were measured
    with `covariance` (m, m), and each with an error `floor` of its own.

    From (I + R' N^-1 R)^-1: prior minus gain leaves rounding alone of parameters far better known than before.
    """
    values, vectors = np.linalg.eigh(covariance)
    seen = (vectors / np.sqrt(np.maximum(values, 0.0) + floor**2)).T @ rows @ root
    left = np.linalg.cholesky(np.eye(root.shape[1]) + seen.T @ seen)
    return np.linalg.norm(solve_triangular(left, root.T, lower=True), axis=0)


def _informed(sigma: Array, knowledge: Knowledge | None) -> Array:
    """Root of the covariance of parameters with independent sigmas (p,) when some combinations are known."""
    if knowledge is None:
        return np.diag(sigma)
    rows = knowledge.combination * sigma
    size = np.linalg.norm(rows, axis=1)
    informed = size > 0
    rows = rows[informed] / size[informed, None]
    noise = knowledge.covariance[np.ix_(informed, informed)] / np.outer(size[informed], size[informed])
    inverse = np.asarray(np.linalg.pinv(rows @ rows.T + noise, hermitian=True), dtype=np.float64)
    left = np.eye(len(sigma)) - rows.T @ inverse @ rows
    values, vectors = np.linalg.eigh((left + left.T) / 2)
    return sigma[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))


def _moments(robot: Robot) -> Array:
    """(11 n, 4 n): masses and first moments of the links, scaled by those of CAD."""
    inertial = robot.chain.inertial
    size = np.abs(inertial[:, :1]), np.linalg.norm(inertial[:, 1:4], axis=1, keepdims=True)
    sizes = np.hstack([size[0], np.repeat(np.maximum(size[1], LEAST_MOMENT * size[0]), 3, axis=1)])
    every = np.eye(11 * len(inertial))[:, : inertial.size].reshape(-1, len(inertial), 10)[..., :4]
    return (every * sizes).reshape(len(every), -1)


def _payload(robot: Robot) -> Array:
    """(11 n, 10): all parameters of a body on the last joint."""
    last = robot.chain.inertial.size
    sizes = (1.0, 0.3, 0.1)  # kg, kg m, kg m^2: relative, of mass, first moment and inertia
    return np.eye(11 * len(robot.joints))[:, last - 10 : last] * np.repeat(sizes, (1, 3, 6))


def _tilts(robot: Robot, index: int, poses: Array) -> Array:
    """(3 m, 3): change of the load if gravity is rotated by 1 rad about each axis of the base."""
    parameters, result = robot.chain.inertial.ravel(), list[Array]()
    for about in np.eye(3):
        rows = gravity_rows(robot.chain, np.cross(about, robot.gravity), index, poses) @ parameters
        result.append(np.concatenate([np.zeros(len(rows)), rows[:, 0], rows[:, 1]]))
    return np.stack(result, axis=-1)


def _by_own_angle(angle: Array) -> Array:
    """(3 m, 2): A cos q + B sin q with the angle of this axis (m,), independent of the other joints."""
    none, cosine, sine = np.zeros_like(angle), np.cos(angle), np.sin(angle)
    return np.stack([np.concatenate([none, cosine, -sine]), np.concatenate([none, sine, cosine])], axis=-1)


def _unit(columns: Array, size: float) -> float:
    """Factor that scales the longest column to `size`."""
    longest = float(np.linalg.norm(columns, axis=0).max(initial=0.0))
    return size / longest if longest > 0 else 0.0


def _telling(columns: Array) -> Array:
    """Orthonormal directions (k, r) of columns, without those that hardly change the torque."""
    vectors, values, _ = np.linalg.svd(columns, full_matrices=False)
    # 1e-3 of the largest singular value of an effect: smaller directions hardly change the torque
    return vectors[:, (values > 1e-3 * values.max(initial=0.0)) & (values > 0)]


def _inverse(covariance: Array, slack: float) -> Array:
    values, vectors = np.linalg.eigh(covariance)
    return (vectors / (np.maximum(values, 0.0) + slack)) @ vectors.T
