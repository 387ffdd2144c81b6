"""Sweeps that follow their set-points on a machine made of the model's own columns: what a test wants to be there."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.fit.equations import Equations, Term, equations, grouped
from service.diagnosis.rows.rigid import load_rows, nominal_load
from service.diagnosis.rows.signals import Tracks, tracks
from service.diagnosis.sensitivity import expected
from service.identification.design.diagnosis_sweeps import BLOCKS, DesignedSweep, full_design
from service.identification.estimates.torque_gain import KnownMass
from service.model import Robot, Sweep
from tests.numeric.campaign import max100

Array = NDArray[np.float64]

RATE = 250.0  # Hz: what the tracks keep
FORWARD, SLOW = ("forward_slow",), ("forward_slow", "backward_slow")


def following(
    robot: Robot,
    joint: str,
    designed: Sequence[DesignedSweep],
    hidden: Mapping[Term, Sequence[float]] | None = None,
    *,
    load: Callable[[Tracks], Array] | None = None,
    noise: float = 0.001,
    seed: int = 1,
) -> list[Sweep]:
    """Sweeps with the nominal effort, `hidden` terms with their coefficients, what `load` (3, m) adds to CAD's, and
    noise (of the rated effort).
    """
    index, random = robot.index(joint), np.random.default_rng(seed)
    bare = [expected(one, one.spec.pose[index]) for one in designed]
    motion = tracks(robot, joint, bare)
    effort = motion.along(nominal_load(robot, joint, motion.poses) + (0.0 if load is None else load(motion)))
    effort += (robot.axis(joint).viscous_friction or 0) * motion.velocity
    nominal = replace(motion, effort=effort.copy())
    model = equations(nominal, grouped(nominal))
    for term, coefficients in (hidden or {}).items():
        effort += sum(c * column for c, column in zip(coefficients, model.columns(term), strict=True))
    effort += noise * robot.axis(joint).rated_effort * random.standard_normal(effort.shape)
    return [
        replace(sweep, recording=replace(sweep.recording, effort=effort[number, : len(sweep.recording.time)]))
        for number, sweep in enumerate(bare)
    ]


def swept(
    joint: str,
    poses: Array,
    hidden: Mapping[Term, Sequence[float]] | None = None,
    *,
    robot: Robot | None = None,
    blocks: Sequence[str] = BLOCKS,
    repeats: int = 2,
    revisit: bool = True,
    load: Callable[[Tracks], Array] | None = None,
    noise: float = 0.001,
    seed: int = 1,
) -> list[Sweep]:
    """The full design, or some of its blocks, followed by the representative robot or another one."""
    robot = robot or max100()
    designed = full_design(robot, joint, poses, blocks=blocks, repeats=repeats, sample_rate=RATE, revisit=revisit)
    return following(robot, joint, designed, hidden, load=load, noise=noise, seed=seed)


def known_to(part: float) -> Robot:
    """The representative robot, of which CAD knows inertia and gravity to a part, one sigma."""
    robot = max100()
    prior = robot.prior.model_copy(update={"gravity": part, "inertia": part})
    return replace(robot, description=robot.description.model_copy(update={"prior": prior}))


def heavier(part: float) -> Callable[[Tracks], Array]:
    """All of CAD's load once more by a part, as a wrong torque gain shows it."""
    return lambda motion: part * nominal_load(motion.robot, motion.joint, motion.poses)


def carrying(mass: KnownMass) -> Callable[[Tracks], Array]:
    """A body on the last link."""

    def load(motion: Tracks) -> Array:
        links = motion.robot.chain.inertial.size
        rows = load_rows(motion.robot, motion.robot.index(motion.joint), motion.poses)
        return (rows[:, links - 10 : links] @ mass.parameters).reshape(3, -1)

    return load


def equations_of(robot: Robot, joint: str, sweeps: Sequence[Sweep]) -> Equations:
    """What a diagnosis makes of them."""
    motion = tracks(robot, joint, sweeps)
    return equations(motion, grouped(motion))
