"""Regressor and base parameters: against Pinocchio called pose by pose, and against column-pivoted QR."""

from collections.abc import Iterator

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.linalg import qr, solve_triangular

from service.identification.model.base_parameters import TOLERANCE, joint_ranges, reduce_columns
from service.identification.model.regressor import axis_rows, inertia_rows, parameter_names
from service.robot import Robot
from tests.benchmarks.bench.measured import Measured, beside
from tests.numeric.campaign import max100

Array = NDArray[np.float64]


def by_pinocchio(robot: Robot, poses: Array) -> Array:
    """Rows (axes, m, 10 n): torque of a unit acceleration without gravity, a call an axis and pose."""
    model = pin.buildModelFromXML(robot.urdf_text)
    model.gravity.linear = np.zeros(3)
    data, still, units = model.createData(), np.zeros(model.nv), np.eye(model.nv)
    rows = np.empty((model.nv, len(poses), 10 * model.nv))
    for m, pose in enumerate(poses):
        for axis, unit in enumerate(units):
            rows[axis, m] = pin.computeJointTorqueRegressor(model, data, pose, still, unit)[axis]
    return rows


def ours(robot: Robot, poses: Array) -> Array:
    return np.stack([inertia_rows(robot.chain, axis, poses) for axis in range(len(robot.axes))])


def by_qr(rows: Array) -> tuple[list[int], Array]:
    """Columns and regrouping by column-pivoted QR (Gautier 1991)."""
    length = np.linalg.norm(rows, axis=0)
    scaled = rows / np.where(length > TOLERANCE * length.max(), length, 1.0)
    triangle, order = qr(scaled, mode="r", pivoting=True)
    size = np.abs(np.diag(triangle))
    rank = int(np.sum(size > 1e3 * TOLERANCE * size[0]))
    return order[:rank].tolist(), solve_triangular(triangle[:rank, :rank], triangle[:rank, rank:])


def drawn(robot: Robot, count: int) -> Array:
    lower, upper = joint_ranges(robot.chain)
    return np.random.default_rng(0).uniform(lower, upper, (count, len(lower)))


def compared(poses: int, repeats: int, *, best: bool = False) -> Iterator[Measured]:
    robot = max100()
    at = drawn(robot, poses)
    found = beside(lambda: ours(robot, at), lambda: by_pinocchio(robot, at), repeats)
    apart = float(np.abs(found.mine - found.theirs).max() / np.abs(found.theirs).max())
    yield found.as_measured(
        "regressor of six axes", "Pinocchio, one call per axis and pose", amount=6 * poses, unit="rows/s", best=best,
        note=f"largest difference {apart:.0e}",
    )  # fmt: skip
    tall, names = np.vstack([axis_rows(robot.chain, axis, at) for axis in range(6)]), parameter_names(robot.chain)
    base = beside(lambda: reduce_columns(tall, names), lambda: by_qr(tall), repeats)
    yield base.as_measured(
        f"base parameters of {len(tall)} x {tall.shape[1]}", "column-pivoted QR with its regrouping", best=best,
        note=f"ranks {len(base.mine.columns)} and {len(base.theirs[0])}",
    )  # fmt: skip


def run() -> Iterator[Measured]:
    yield from compared(10_000, 3)


def quick() -> Iterator[Measured]:
    yield from compared(1000, 5, best=True)
