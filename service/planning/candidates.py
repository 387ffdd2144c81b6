"""The measurable poses: the grid of a request without the poses that collide or have no room."""

import math
from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from service.model.configuration import Cell
from service.model.errors import BadInput
from service.model.robot import Robot
from service.planning.documents import PlanRequest
from service.planning.safety.envelope import Envelope

Array = NDArray[np.float64]

LARGEST_GRID = 100_000  # poses


def workspace_grid(robot: Robot, request: PlanRequest, cell: Cell) -> Array:
    """All collision-free poses (m, n) of the request's grid."""
    request.check(robot)
    envelope = Envelope(robot, cell)
    poses = grid(robot, request, envelope, np.array(cell.home_pose(robot.joints)))
    return poses[envelope.checker.collision_free(poses)]


def grid(robot: Robot, request: PlanRequest, envelope: Envelope, home: Array) -> Array:
    """Poses (m, n): the varied joints on multiples of the step within their limits, at most one turn; others home."""
    positions: list[Array] = []
    for joint in request.varied:
        index = robot.index(joint)
        prismatic = robot.chain.joints[index].kind == "prismatic"
        step = request.step / 100 if prismatic else math.radians(request.step)
        low, high = envelope.joint_range(index)
        if not prismatic and high - low > 2 * math.pi:  # beyond one turn, the poses repeat
            low = min(max(low, -math.pi), high - 2 * math.pi)
            high = low + 2 * math.pi - step / 1000
        numbers = np.arange(math.ceil(low / step), math.floor(high / step) + 1, dtype=np.float64)
        positions.append(numbers * step)
    count = math.prod(len(one) for one in positions)
    if count > LARGEST_GRID:
        raise BadInput("step", f"{request.step} gives a grid of {count} poses, limit {LARGEST_GRID}")
    poses = np.tile(home, (count, 1))
    poses[:, [robot.index(joint) for joint in request.varied]] = list(product(*positions))
    return poses


def has_room(envelope: Envelope, poses: Array, axes: Sequence[int]) -> NDArray[np.bool_]:
    """Poses (m, n) from which each axis can sweep forward or backward."""
    enough = np.ones(len(poses), dtype=bool)
    for axis in axes:
        left = np.flatnonzero(enough)
        forward = room(envelope, poses[left], axis, 1)
        enough[left[~forward]] = room(envelope, poses[left[~forward]], axis, -1)
    return enough


def room(envelope: Envelope, poses: Array, axis: int, direction: int) -> NDArray[np.bool_]:
    """Poses in which joint `axis` can move by the whole travel and its margins in one direction."""
    limits = envelope.limits
    start = poses.copy()
    start[:, axis] -= direction * limits.window_margin
    way = direction * (limits.travel + 2 * limits.window_margin)
    low, high = envelope.joint_range(axis)
    ends = np.stack([start[:, axis], start[:, axis] + way])
    inside = (ends.min(0) >= low) & (ends.max(0) <= high)
    inside[inside] = envelope.checker.travel_free(start[inside], axis, way)
    return inside
