"""Robot time to a confidence: one axis at a time and several at once, and the error of J after equal robot time.

`python -m tests.numeric.second_plant.robot_time PERCENT AXES SEED...` plans to a confidence, for the MAX 100 class
(seed 0) and random arms. With a time, `... 600s AXES SEED...` plans of that time are run on the arms and identified.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from service.identification.design.excitation import Excitation, velocity_setpoint
from service.identification.estimates.combination import combine
from service.identification.estimates.estimate import identify
from service.identification.motion.trajectory_record import axis_track, trajectory
from service.identification.spectra.frequency_response import spectrum
from service.model import Recording, Robot, Sweep
from service.model.configuration import Cell, read_cell, read_robot
from service.planning.documents import PlanDocument, PlannedSweep, PlanRequest, at_once
from service.planning.plan import build_plan
from tests.numeric.second_plant.machine import STEP
from tests.numeric.second_plant.simultaneous import RATE, Arm, arm, run

Array = NDArray[np.float64]
CONFIG = Path("config")


def request(robot: Robot, axes: int, **budget: object) -> PlanRequest:
    joints = robot.joints[:axes]
    return PlanRequest.model_validate({"robot_id": 1, "axes": joints, "varied": joints[1:], **budget})


def times(seed: int, axes: int, confidence: float) -> str:
    """Robot time of each way to a confidence, percent."""
    robot, cell = read_robot(CONFIG / "robots/max100-class.yaml"), read_cell(CONFIG / "cells/workshop.yaml")
    if seed:
        robot, cell = arm(seed, axes).robot, Cell(name="free")
    plan = build_plan(robot, request(robot, axes, confidence=confidence, simultaneous=True), cell)
    alone = next(one.duration for one in plan.compared if not one.groups)
    ways = "; ".join(
        f"{'+'.join(str(len(group)) for group in one.groups) or 'single'} x {one.realisations}: "
        + (f"{one.duration:.0f} s" if one.duration else one.reason[:90])
        for one in plan.compared
    )
    return f"ratio {plan.duration / alone if alone else np.nan:.3f} ({ways})"


def records(plant: Arm, sweeps: Sequence[PlannedSweep], random: np.random.Generator) -> list[Sweep]:
    """Sweeps that run at once, as the arm records them."""
    specs = [sweep.spec for sweep in sweeps]
    runs = [
        Excitation(spec.offset_velocity, spec.sines, spec.period or 0.0, spec.periods or 0, sweep.ramp, sweep.settle)
        for spec, sweep in zip(specs, sweeps, strict=True)
    ]
    steps = STEP * np.arange(round(runs[0].duration / STEP), dtype=np.float64)
    wanted = np.stack([velocity_setpoint(own, steps) for own in runs], -1)
    moving = [plant.robot.index(spec.axis) for spec in specs]
    time, torque, position = run(plant, moving, np.array(specs[0].pose), wanted, random)
    return [
        Sweep(
            spec.model_copy(update={"sample_rate": RATE}),
            Recording(time, torque[:, k], np.gradient(position[:, k], 1 / RATE), position[:, k]),
        )
        for k, spec in enumerate(specs)
    ]


def error(plant: Arm, plan: PlanDocument, axes: int, seed: int) -> str:
    """Of J over the workspace after the sweeps of a plan, and how often two standard deviations hold it."""
    random, robot = np.random.default_rng([9, seed]), plant.robot
    limits = np.array([(joint.lower, joint.upper) for joint in plant.built.joints])
    poses = random.uniform(limits[:, 0] + 0.2, limits[:, 1] - 0.2, (200, len(limits)))
    true = np.array([np.diag(plant.matrix(pose)) for pose in poses])
    sets = at_once(plan.sweeps) or [(number,) for number in range(1, len(plan.sweeps) + 1)]
    recorded = [records(plant, [plan.sweeps[number - 1] for number in own], random) for own in sets]
    if plan.groups:
        found = combine(robot, (), [trajectory(robot, [axis_track(sweep) for sweep in own]) for own in recorded])
        values, std = (np.diagonal(each, axis1=1, axis2=2) for each in found.inertia_matrix(poses))
    else:
        alone = identify(robot, [spectrum(robot, sweep) for own in recorded for sweep in own])
        joints = robot.joints[:axes]
        values = np.stack([alone.identified(joint, poses) for joint in joints], -1)
        std = np.stack([alone.identified_std(joint, poses) for joint in joints], -1)
    off = np.abs(values - true)
    by_axis = " ".join(f"{100 * one:.2f}" for one in np.quantile(off / true, 0.95, axis=0))
    return (
        f"{len(plan.sweeps)} sweeps, {plan.duration:.0f} s: J p95 {100 * np.quantile(off / true, 0.95):.2f} % (axes "
        f"{by_axis}), within two std {100 * np.mean(off < 2 * std):.0f} %, predicted {plan.confidence[-1]}"
    )


def errors(seed: int, axes: int, duration: float) -> str:
    """One axis at a time and all at once, each in this robot time, s."""
    plant, cell = arm(seed, axes), Cell(name="free")
    found: list[str] = []
    for simultaneous in (False, True):
        asked = request(plant.robot, axes, duration=duration, simultaneous=simultaneous)
        plan = build_plan(plant.robot, asked, cell)
        ways = "+".join(str(len(group)) for group in plan.groups) or "single"
        found.append(f"{ways}: {error(plant, plan, axes, seed)}")
    return "\n  ".join(found)


if __name__ == "__main__":
    budget, count = sys.argv[1], int(sys.argv[2])
    for number in map(int, sys.argv[3:]):
        told = errors(number, count, float(budget[:-1])) if budget[-1] == "s" else times(number, count, float(budget))
        print(f"seed {number}: {told}", flush=True)
