"""Blind cases: a list of what is hidden where, and how one of them becomes a machine, a plan and a sealed truth."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from enum import Enum
from typing import Any

import numpy as np

from service.diagnosis.sensitivity.design import DesignedSweep, full_design, paper_design
from service.recording import Sweep
from service.robot import Robot
from simulator.scenario import AddedBody
from tests.numeric.blind.effects import CATALOGUE, OUTSIDE, PAIRS, PULLED
from tests.numeric.blind.machine import BlindMachine, Draft
from tests.numeric.blind.robots import random_poses, random_robot

SIZES = {"small": (0.006, 0.012), "medium": (0.015, 0.03), "large": (0.04, 0.08)}
"""Of the rated effort."""

POSES = 4


class Kind(Enum):
    """What sort of case it is."""

    NONE = "none"
    SINGLE = "single"
    PAIR = "pair"
    OUTSIDE = "outside"


class Design(Enum):
    """Which sweeps are run."""

    FULL = "full"
    PAPER = "paper"


@dataclass(frozen=True)
class Case:
    """What is hidden; `seed` decides the rest."""

    number: int
    kind: Kind
    names: tuple[str, ...]
    size: str
    design: Design
    seed: tuple[int, ...]


@dataclass(frozen=True)
class Truth:
    """Sealed: the scorer alone reads it. Parameters are those that a diagnosis may state, under its names."""

    number: int
    kind: str
    names: tuple[str, ...]
    size: str
    design: str
    joint: str
    torque: float  # N m
    noise: float  # of the effort, N m RMS a sample
    parameters: dict[str, dict[str, float]]

    def document(self) -> dict[str, Any]:
        return asdict(self)


@dataclass(frozen=True)
class Evidence:
    """All that a diagnosis may see: sweeps, and a way to measure more."""

    robot: Robot
    joint: str
    designs: tuple[DesignedSweep, ...]
    sweeps: tuple[Sweep, ...]  # of the designs
    measure: Callable[[Sequence[DesignedSweep], AddedBody | None], tuple[Sweep, ...]]


@dataclass(frozen=True)
class Scene:
    """A machine to be measured and what is to be run on it, with the truth beside it."""

    machine: BlindMachine
    robot: Robot
    joint: str
    designs: tuple[DesignedSweep, ...]
    truth: Truth

    def evidence(self) -> Evidence:
        """Measure what was designed."""
        return Evidence(self.robot, self.joint, self.designs, self.machine.measure(self.designs), self.machine.measure)


def cases(
    seed: int,
    *,
    singles: int,
    none: int,
    pairs: int,
    outside: int,
    design: Design = Design.FULL,
    sizes: Sequence[str] = ("medium", "large"),
) -> Iterator[Case]:
    """`singles` cases of every effect in every size, `none` without any, `pairs` and `outside` in all."""
    wanted = [(Kind.SINGLE, (name,), size) for name in CATALOGUE for size in sizes for _ in range(singles)]
    wanted += [(Kind.NONE, (), "none")] * none
    wanted += [(Kind.PAIR, PAIRS[k % len(PAIRS)], sizes[k // len(PAIRS) % len(sizes)]) for k in range(pairs)]
    strange = tuple(OUTSIDE)
    wanted += [
        (Kind.OUTSIDE, (strange[k % len(strange)],), sizes[k // len(strange) % len(sizes)]) for k in range(outside)
    ]
    for number, (kind, names, size) in enumerate(wanted):
        yield Case(number, kind, names, size, design, (seed, number))


def scene(case: Case, *, bare: bool = False) -> Scene:
    """The machine of a case; everything random comes from its seed. `bare`: the same with nothing hidden."""
    random = np.random.default_rng(case.seed)
    pair = random_robot(random, f"blind-{case.number:04}")
    joint = _joint(random, case.names)
    index = pair.robot.index(joint)
    poses = random_poses(random, pair.robot.chain, index, POSES)
    make = full_design if case.design is Design.FULL else paper_design
    axis, low_high = pair.robot.axis(joint), SIZES.get(case.size, (0.0, 0.0))
    viscous = (axis.viscous_friction or 0.0) * random.uniform(0.6, 1.5)
    on_motor = random.uniform(0.3, 0.9) * viscous
    noise = random.uniform(0.001, 0.005)
    draft = Draft(
        random=random,
        robot=pair.robot,
        nominal=pair.nominal,
        joint=joint,
        designs=make(pair.robot, joint, poses),
        size=random.uniform(*low_high) * axis.rated_effort,
        train={
            "motor_inertia": (axis.motor_inertia or 0.0) * random.uniform(0.93, 1.07),
            "motor_friction": {"viscous": on_motor},
            "load_friction": {"viscous": viscous - on_motor},
        },
        measurement={
            "effort_noise": noise,
            "effort_resolution": 0.001,
            "velocity_noise": 5e-6,
            "position_noise": 2e-8,
        },
        links={f"link_{k}": {"inertia": random.uniform(0.8, 1.2)} for k in range(1, 5)},
    )
    hidden = CATALOGUE | OUTSIDE
    parameters = {name: hidden[name](draft) for name in case.names if not bare}
    truth = Truth(
        case.number, case.kind.value, case.names, case.size, case.design.value, joint,
        draft.size, noise * axis.rated_effort, parameters,
    )  # fmt: skip
    machine = BlindMachine(draft, int(random.integers(2**31)))
    return Scene(machine, pair.robot, joint, draft.designs, truth)


def _joint(random: np.random.Generator, names: tuple[str, ...]) -> str:
    """One that can show the effects: those that weight makes need weight, play needs torque that reverses."""
    if "backlash" in names:
        return "joint_1"
    if any(name in PULLED for name in names):
        return f"joint_{random.integers(2, 4)}"
    return f"joint_{random.integers(1, 4)}"
