"""Choosing poses: against a fresh SVD for every candidate of every step, and against batched `eigvalsh`."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from docs.benchmarks.measured import Measured, Timed, beside, timed
from service.identification.design.pose_selection import Criterion, PoseLimits, choices, condition_numbers
from service.identification.model import joint_ranges
from service.identification.model.base_parameters import base_parameters
from service.model import Robot
from service.model.configuration import Cell, read_cell, read_robot
from service.planning.documents import PlanRequest
from service.planning.plan import build_plan
from service.planning.poses import has_room, observe
from service.planning.safety.envelope_check import Envelope
from tests.naive_selection import naive_condition
from tests.numeric.campaign import CONFIG

Array = NDArray[np.float64]

SECOND, THIRD = 48, 36  # 1,728 poses, as many as the paper's grid has
POSES = 300
MOST_SECONDS, LEAST_SPEEDUP, MOST_SECONDS_SIX = 2.0, 8.0, 30.0
SIX, FEW = 20_000, 12  # candidates of six axes, and picks for which the peer is given time
STEP = np.radians(5.0)
REQUEST = PlanRequest(
    robot_id=1, axes=("joint_1", "joint_2", "joint_3"), varied=("joint_2", "joint_3"), poses=POSES
)  # fmt: skip


def robot_and_cell() -> tuple[Robot, Cell]:
    return read_robot(CONFIG / "robots/max100-class.yaml"), read_cell(CONFIG / "cells/workshop.yaml")


def batched_condition(rows: Array, count: int) -> list[int]:
    """The picks of criterion `condition`: eigenvalues of every candidate's Gram matrix in one call a step."""
    candidates, _, size = rows.shape
    length = np.sqrt(np.sum(rows**2, axis=(0, 1)))
    scaled = rows / np.where(length > 0, length, 1.0)
    own = scaled.swapaxes(1, 2) @ scaled
    ridge = PoseLimits.ridge * float(np.sum(scaled**2)) / candidates / size
    gram, left, picks = np.zeros((size, size)), np.ones(candidates, dtype=bool), list[int]()
    for _ in range(count):
        eigenvalues = np.asarray(np.linalg.eigvalsh(gram + own), dtype=float)
        condition = np.where(left, condition_numbers(eigenvalues), np.inf)
        least = float(condition.min())
        if np.isfinite(least):
            pick = int(np.flatnonzero(condition <= least * (1 + PoseLimits.tie))[0])
        else:
            volume = np.where(left, np.log(np.maximum(eigenvalues, 0.0) + ridge).sum(axis=1), -np.inf)
            pick = int(np.flatnonzero(volume >= volume.max() - PoseLimits.tie)[0])
        left[pick] = False
        gram = gram + own[pick]
        picks.append(pick)
    return picks


def measurable_rows(robot: Robot, cell: Cell) -> Array:
    """Rows of the poses of axes 2 and 3 on a grid over their ranges that are free, with room for a sweep."""
    lower, upper = joint_ranges(robot.chain)
    grid = np.zeros((SECOND * THIRD, 6))
    second, third = (np.linspace(lower[k], upper[k], n) for k, n in ((1, SECOND), (2, THIRD)))
    grid[:, 1], grid[:, 2] = np.repeat(second, THIRD), np.tile(third, SECOND)
    envelope = Envelope(robot, cell)
    free = grid[envelope.checker.collision_free(grid)]
    free = free[has_room(envelope, free, (0, 1, 2))]
    return observe(robot, REQUEST, np.array(cell.home_pose(robot.joints))).rows(free)


def free_of_six(robot: Robot, cell: Cell, count: int) -> Array:
    """Random poses (count, 6) on the 5 deg grid that touch nothing."""
    lower, upper = joint_ranges(robot.chain)
    rng, free = np.random.default_rng(0), np.zeros((0, 6))
    checker = Envelope(robot, cell).checker
    while len(free) < count:
        drawn = np.round(rng.uniform(lower, upper, (count, 6)) / STEP) * STEP
        drawn[:, 0] = 0.0  # no inertia depends on it
        free = np.unique(np.vstack([free, drawn[checker.collision_free(drawn)]]), axis=0)
    return rng.permutation(free)[:count]


def run() -> Iterator[Measured]:
    robot, cell = robot_and_cell()
    preparing, rows = timed(lambda: measurable_rows(robot, cell))
    naive = beside(lambda: _ours(rows, POSES), lambda: naive_condition(rows, POSES)[0], 3, peer_repeats=1)
    whole = replace(
        naive,
        ours=tuple(preparing + seconds for seconds in naive.ours),
        peer=tuple(preparing + seconds for seconds in naive.peer),
    )
    told = whole.as_measured(
        "300 of 1,728 poses, with grid and collisions", "SVD for every candidate",
        note=f"{len(rows)} free; {_picks(naive)}",
    )  # fmt: skip
    met = told.ours <= MOST_SECONDS and (told.ratio or 0) >= LEAST_SPEEDUP and naive.mine == naive.theirs
    yield replace(told, target=f"<= {MOST_SECONDS:g} s, >= {LEAST_SPEEDUP:g} x, same picks", met=met)
    batched = beside(lambda: _ours(rows, POSES), lambda: batched_condition(rows, POSES), 3)
    yield batched.as_measured("the selection alone", "batched eigvalsh", note=_picks(batched))
    seconds, plan = timed(lambda: build_plan(robot, REQUEST, cell))
    yield Measured(
        name="the whole plan of 300 poses, with paths", unit="s", ours=seconds, note=f"{len(plan.sweeps)} sweeps"
    )
    base, free = base_parameters(robot.chain, tuple(range(6))), free_of_six(robot, cell, SIX)
    rows = np.stack([base.rows(robot.chain, axis, free) for axis in range(6)], axis=1)
    seconds, _ = timed(lambda: _ours(rows, POSES))
    yield Measured(
        name="six axes: 300 of 20,000 poses", unit="s", ours=seconds,
        target=f"<= {MOST_SECONDS_SIX:g} s", met=seconds <= MOST_SECONDS_SIX,
    )  # fmt: skip
    few = beside(lambda: _ours(rows, FEW), lambda: batched_condition(rows, FEW), 2, peer_repeats=1)
    yield few.as_measured(f"six axes: the first {FEW} of them", "batched eigvalsh", note=_picks(few))


def quick() -> Iterator[Measured]:
    """300 candidates of three axes, 20 and 150 picks."""
    robot, _ = robot_and_cell()
    poses = np.zeros((300, 6))
    poses[:, 1:3] = np.random.default_rng(0).uniform(-1.5, 1.0, (300, 2))
    rows = observe(robot, REQUEST, np.zeros(6)).rows(poses)
    naive = beside(lambda: _ours(rows, 20), lambda: naive_condition(rows, 20)[0], 5, peer_repeats=3)
    yield naive.as_measured("selection of poses", "SVD for every candidate", best=True)
    batched = beside(lambda: _ours(rows, 150), lambda: batched_condition(rows, 150), 5)
    yield batched.as_measured("selection of poses, batched", "batched eigvalsh", best=True)


def _ours(rows: Array, count: int) -> list[int]:
    return [pick for pick, _ in islice(choices(rows, Criterion.CONDITION), count)]


def _picks(found: Timed[list[int], list[int]]) -> str:
    return "same picks" if found.mine == found.theirs else "OTHER picks"
