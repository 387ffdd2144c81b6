"""How fast poses are planned, and how good the choice is. Prints each figure and writes `results/planning.json`.

    python -m tests.benchmarks.planning [--poses 300] [--candidates 20000] [--subsample 400]

Axes 2 and 3, 5 deg grid of the workshop cell: the whole plan; the choice of poses (grid and collisions included)
against a fresh SVD of the stacked matrix for every candidate of every step, in the same run, pick for pick. Six axes,
random poses on the 5 deg grid that touch nothing: the choice, and its condition number against the slow way's on a
subsample. The other criteria beside them.
"""

import argparse
import json
import math
import time
from collections.abc import Callable
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from service.configuration import read_robot
from service.geometry.cell import Cell, read_cell
from service.identification.design.pose_selection import Criterion, choices, select_poses
from service.identification.model.base_parameters import base_parameters, joint_ranges
from service.planning.candidates import grid, has_room
from service.planning.observability import observe
from service.planning.plan import PlanRequest, build_plan
from service.robot import Robot
from service.safety.envelope import Envelope
from service.safety.travel import order_poses
from tests.naive_selection import naive_condition

ROOT = Path(__file__).parents[2]
RESULT = Path(__file__).parent / "results" / "planning.json"
STEP = math.radians(5)
MOST_SECONDS, LEAST_SPEEDUP = 2.0, 8.0  # axes 2 and 3
MOST_SECONDS_SIX, MOST_EXCESS = 60.0, 0.05  # six axes


def timed(work: Callable[[], Any]) -> tuple[Any, float]:
    start = time.perf_counter()
    result = work()
    return result, time.perf_counter() - start


def three_axes(robot: Robot, cell: Cell, poses: int) -> dict[str, Any]:
    request = PlanRequest(
        robot_id=1, axes=("joint_1", "joint_2", "joint_3"), varied=("joint_2", "joint_3"), poses=poses
    )
    home = np.array(cell.home_pose(robot.joints))

    def candidates() -> tuple[np.ndarray, np.ndarray]:
        envelope = Envelope(robot, cell)
        all_poses = grid(robot, request, envelope, home)
        free = all_poses[envelope.checker.collision_free(all_poses)]
        free = free[has_room(envelope, free, (0, 1, 2))]
        return free, observe(robot, request, home).rows(free)

    (free, rows), preparing = timed(candidates)
    chosen, choosing = timed(lambda: select_poses(rows, poses, Criterion.CONDITION))
    (picks, _), naive = timed(lambda: naive_condition(rows, poses))
    plan, whole = timed(lambda: build_plan(robot, request, cell))
    figures: dict[str, Any] = {
        "grid": plan.candidates,
        "candidates": len(free),
        "base parameters": rows.shape[2],
        "grid, collisions, rows: s": preparing,
        "choice: s": choosing,
        "choice the naive way: s": naive,
        "seconds": preparing + choosing,
        "speedup of the choice": naive / choosing,
        "speedup, grid and collisions in both": (preparing + naive) / (preparing + choosing),
        "same picks": list(chosen.picks) == picks,
        "condition number": chosen.condition[-1],
        "whole plan: s": whole,
        "sweeps of the plan": len(plan.sweeps),
        "predicted confidence: %": plan.confidence[-1],
        "poses that add nothing": len(plan.spare),
    }
    for criterion in Criterion:
        taken, seconds = timed(lambda by=criterion: list(islice(choices(rows, by, free, home), poses)))
        tour, ordering = timed(lambda by=taken: order_poses(free[[pick for pick, _ in by]], home))
        way = np.vstack([home, free[[taken[k][0] for k in tour]]])
        figures[criterion.value] = {
            "choice: s": seconds,
            "condition number": taken[-1][1],
            "order: s": ordering,
            "way: rad": float(np.abs(np.diff(way, axis=0)).sum()),
        }
    return figures


def free_of_six(robot: Robot, cell: Cell, count: int) -> np.ndarray:
    """Random poses (count, 6) on the 5 deg grid that touch nothing."""
    lower, upper = joint_ranges(robot.chain)
    rng, free = np.random.default_rng(0), np.zeros((0, 6))
    checker = Envelope(robot, cell).checker
    while len(free) < count:
        drawn = np.round(rng.uniform(lower, upper, (count, 6)) / STEP) * STEP
        drawn[:, 0] = 0.0  # no inertia depends on it
        free = np.unique(np.vstack([free, drawn[checker.collision_free(drawn)]]), axis=0)
    return rng.permutation(free)[:count]


def six_axes(robot: Robot, cell: Cell, poses: int, count: int, subsample: int) -> dict[str, Any]:
    base, free = base_parameters(robot.chain, tuple(range(6))), free_of_six(robot, cell, count)
    rows = np.stack([base.rows(robot.chain, axis, free) for axis in range(6)], axis=1)
    chosen, choosing = timed(lambda: select_poses(rows, poses, Criterion.CONDITION))
    few = rows[:subsample]
    within = min(poses, subsample // 2)
    (picks, condition), naive = timed(lambda: naive_condition(few, within))
    ours = select_poses(few, within, Criterion.CONDITION)
    return {
        "candidates": len(rows),
        "base parameters": rows.shape[2],
        "seconds": choosing,
        "condition number": chosen.condition[-1],
        "subsample": subsample,
        "poses of the subsample": within,
        "condition number, subsample": ours.condition[-1],
        "condition number, subsample, exact greedy": condition[-1],
        "excess": ours.condition[-1] / condition[-1] - 1,
        "same picks": list(ours.picks) == picks,
        "choice the naive way, subsample: s": naive,
    }


def judge(figures: dict[str, Any]) -> dict[str, bool]:
    three, six = figures["axes 2 and 3"], figures["six axes"]
    return {
        f"axes 2 and 3 in <= {MOST_SECONDS} s": three["seconds"] <= MOST_SECONDS,
        f">= {LEAST_SPEEDUP} x the naive way": three["speedup, grid and collisions in both"] >= LEAST_SPEEDUP,
        "same picks": three["same picks"],
        f"six axes in <= {MOST_SECONDS_SIX} s": six["seconds"] <= MOST_SECONDS_SIX,
        f"condition number within {MOST_EXCESS:.0%} of exact greedy": abs(six["excess"]) <= MOST_EXCESS,
    }


def show(figures: dict[str, Any], indent: str = "") -> None:
    for name, value in figures.items():
        if isinstance(value, dict):
            print(f"{indent}{name}")
            show(value, indent + "  ")
        else:
            print(f"{indent}{name:45} {f'{value:.4g}' if isinstance(value, float) else value}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--poses", type=int, default=300)
    parser.add_argument("--candidates", type=int, default=20_000)
    parser.add_argument("--subsample", type=int, default=400)
    wanted = parser.parse_args()
    robot = read_robot(ROOT / "config/robots/max100-class.yaml")
    cell = read_cell(ROOT / "config/cells/workshop.yaml")
    figures = {
        "poses": wanted.poses,
        "axes 2 and 3": three_axes(robot, cell, wanted.poses),
        "six axes": six_axes(robot, cell, wanted.poses, wanted.candidates, wanted.subsample),
    }
    figures["done"] = judge(figures)
    show(figures)
    RESULT.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
