"""Sweeps that follow their set-points on a machine made of the model's own columns: what a test wants to be there."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from service.diagnosis.design import DesignedSweep
from service.diagnosis.equations import Equations, Term, equations, grouped, nominal_inertia
from service.diagnosis.prospect import expected
from service.diagnosis.signals import tracks
from service.recording import Sweep
from service.robot import Robot

RATE = 250.0  # Hz: what the tracks keep


def following(
    robot: Robot,
    joint: str,
    designed: Sequence[DesignedSweep],
    hidden: Mapping[Term, Sequence[float]] | None = None,
    *,
    noise: float = 0.001,
    seed: int = 1,
) -> list[Sweep]:
    """Sweeps with the nominal effort, `hidden` terms with their coefficients, and noise (of the rated effort)."""
    index, random = robot.index(joint), np.random.default_rng(seed)
    bare = [expected(one, one.spec.pose[index]) for one in designed]
    motion = tracks(robot, joint, bare)
    model = equations(motion, grouped(motion))
    inertia = nominal_inertia(robot, index, motion.poses)[motion.spot][:, None]
    effort = (
        motion.gravity + inertia * motion.acceleration + (robot.axis(joint).viscous_friction or 0) * motion.velocity
    )
    for term, coefficients in (hidden or {}).items():
        effort += sum(c * column for c, column in zip(coefficients, model.columns(term), strict=True))
    effort += noise * robot.axis(joint).rated_effort * random.standard_normal(effort.shape)
    return [
        replace(sweep, recording=replace(sweep.recording, effort=effort[number, : len(sweep.recording.time)]))
        for number, sweep in enumerate(bare)
    ]


def equations_of(robot: Robot, joint: str, sweeps: Sequence[Sweep]) -> Equations:
    """What a diagnosis makes of them."""
    motion = tracks(robot, joint, sweeps)
    return equations(motion, grouped(motion))
