"""From a seed to a machine: a robot as on paper and as built, an axis that can show what is hidden, its sweeps."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.model import Axis, Prior, Robot, RobotDescription, SweepSpec, build_robot
from tests.numeric.second_plant.bodies import Rigid
from tests.numeric.second_plant.draft import Draft, Hidden
from tests.numeric.second_plant.effects import CATALOGUE, FIRST, FREE, PULLED, TIGHT, TURNING, parallel
from tests.numeric.second_plant.faults import WITH_RIPPLE
from tests.numeric.second_plant.machine import STEP, Controls
from tests.numeric.second_plant.outside import OUTSIDE, PLUMB, SWINGING
from tests.numeric.second_plant.plans import followed, motion, plan
from tests.numeric.second_plant.robots import FAMILIES, Body, Mechanism, put_off, random_mechanism, urdf
from tests.numeric.second_plant.sensors import Sensors

Array = NDArray[np.float64]

LIGHT, HEAVY = 10.0, 1500.0  # kg m^2 (kg) of an axis that is measured
SHARES = {"small": (0.0, 0.0), "medium": (0.015, 0.03), "large": (0.03, 0.08), "none": (0.0, 0.0)}  # of rated effort
WEIGHS = 0.15  # of the rated effort: weight that can be told by
SAMPLED = 0.45  # of the sample rate: no ripple is faster, as drives that sample slower filter first
FAMILY_SHARES = (0.46, 0.14, 0.13, 0.14, 0.13)


@dataclass(frozen=True)
class Wanted:
    """What a case asks for; with `fault` the names are of broken data, no effects."""

    names: tuple[str, ...]
    size: str
    outside: bool = False
    fault: bool = False
    small: bool = False
    bare: bool = False  # the same machine with nothing hidden
    later: tuple[tuple[SweepSpec, Body | None], ...] = ()  # further sweeps, with what is bolted to the flange


@dataclass(frozen=True)
class Scene:
    """A machine to be stepped, the robot as on paper, and what is hidden."""

    draft: Draft
    robot: Robot
    joint: str
    controls: Controls
    hidden: dict[str, Hidden]
    off_by: float
    setpoint: bool


@dataclass(frozen=True)
class _Place:
    """An axis with what is known of it before anything is hidden."""

    cad: Mechanism
    index: int
    inertia: float  # kg m^2, the mean of some poses
    weight: float  # N m, the largest of them
    rated: tuple[float, ...]


def build(random: np.random.Generator, wanted: Wanted, name: str) -> Scene:
    """Everything random comes from `random`; effects draw from a stream of their own."""
    own = random.spawn(1)[0]
    place = _place(random, wanted, name)
    tight = random.random() < 0.25 or any(n in TIGHT for n in wanted.names)
    low, high = (0.015, 0.025) if tight else (0.10, 0.18)
    built = put_off(place.cad, low, high, random)
    rated, index = place.rated[place.index], place.index
    motor_nominal = place.inertia * random.uniform(0.2, 0.7)
    ratios = np.round(random.uniform(60.0, 250.0, len(place.rated)), 1)
    viscous = rated * random.uniform(0.2, 0.4)
    joint = place.cad.names[index]
    motor = motor_nominal * (1.0 + (0.03 if tight else 0.1) * float(np.clip(random.normal(), -1.5, 1.5)))
    limits = np.array([(j.lower, j.upper) for j in place.cad.joints])
    planned = plan(random, joint, index, limits, place.inertia + motor_nominal, rated, small=wanted.small)
    drawn = len(planned.specs)
    planned = followed(planned, [spec for spec, _ in wanted.later])
    wished = motion(planned, STEP)
    fastest = float(np.abs(wished.velocity[:, :drawn]).max()) * ratios[index] / (2 * np.pi)  # of the motor, turns/s
    count = float(random.choice([n for n in (36, 24, 16, 12, 8) if 2 * n * fastest < SAMPLED * planned.rate]))
    cogging, transmission = (count, 2 * count), (1.0, 2.0)
    sensors = _sensors(random, rated, float(ratios[index]))
    size = rated * random.uniform(*SHARES[wanted.size])
    if wanted.size == "small":
        size = sensors.floor * random.uniform(1.0, 2.0)
    draft = Draft(
        random=own, later=np.random.default_rng(drawn), drawn=drawn, built=built, index=index, plan=planned,
        wanted=wished, rated=rated,
        ratio=float(ratios[index]), cogging_orders=cogging, transmission_orders=transmission, size=size,
        size_class=wanted.size, motor=motor, viscous=viscous * random.uniform(0.75, 1.3), nominal_viscous=viscous,
        tight=tight, sensors=sensors,
        carried=(None,) * drawn + tuple(body for _, body in wanted.later),
    )  # fmt: skip
    hidden = {} if wanted.bare else _hide(draft, wanted)
    inertia = place.inertia + motor_nominal
    bandwidth = 2 * np.pi * (random.uniform(6.0, 12.0) if draft.train.spring else random.uniform(12.0, 25.0))
    controls = Controls(
        speed=inertia * bandwidth, reset=bandwidth / 6, position=random.uniform(1.0, 3.0), inertia=inertia,
        viscous=viscous, limit=2.5 * rated,
    )  # fmt: skip
    axes = [
        Axis(
            joint=one, gear_ratio=float(ratio),
            motor_inertia=float(motor_nominal * (effort / rated) / ratio**2), rated_effort=effort,
            viscous_friction=float(round(viscous * effort / rated, 2)), cogging_orders=cogging,
            transmission_orders=transmission, counterbalance=draft.on_paper if one == joint else None,
        )
        for one, ratio, effort in zip(place.cad.names, ratios, place.rated, strict=True)
    ]  # fmt: skip
    description = RobotDescription(
        name=name, urdf="robot.urdf", axes=tuple(axes),
        prior=Prior(
            inertia=0.03 if tight else 0.3, gravity=0.03 if tight else 0.3, viscous_friction=0.5,
            motor_inertia=0.03 if tight else 0.1, effort_gain=0.05,
        ),
    )  # fmt: skip
    robot = build_robot(description, urdf(place.cad))
    return Scene(draft, robot, joint, controls, hidden, (low + high) / 2, bool(random.random() < 0.6))


def _hide(draft: Draft, wanted: Wanted) -> dict[str, Hidden]:
    """Bodies first: what looks at them later sees them as they are."""
    names: Sequence[str] = wanted.names
    if wanted.fault:
        names = ("cogging_torque",) if names[0] in WITH_RIPPLE else ()
    known = OUTSIDE if wanted.outside else CATALOGUE
    first = sorted(names, key=lambda name: name not in FIRST)
    done = {name: known[name](draft) for name in first}
    return {name: done[name] for name in names if wanted.size != "none"}


def _place(random: np.random.Generator, wanted: Wanted, name: str) -> _Place:
    """Robots are drawn until one has an axis on which what is hidden can show."""
    while True:
        family = str(random.choice(FAMILIES, p=FAMILY_SHARES))
        cad = random_mechanism(random, name, family)
        rigid = Rigid(cad)
        limits = np.array([(j.lower, j.upper) for j in cad.joints])
        poses = random.uniform(limits[:, 0] + 0.4, limits[:, 1] - 0.4, (12, len(limits)))
        inertias = np.array([np.diag(rigid.matrix(pose)) for pose in poses])
        weights = np.array([np.abs(rigid.holding(pose)) for pose in poses]).max(axis=0)
        agility = random.uniform(4.0, 7.0)  # rad/s^2 (m/s^2) at rated effort
        rated = np.maximum(agility * inertias.mean(axis=0), random.uniform(1.5, 2.0) * weights)
        rated = np.maximum(np.round(rated, -1), 10.0)
        fits = [k for k in range(len(limits)) if _shows(wanted, cad, k, inertias[:, k], weights[k] / rated[k])]
        if fits:
            index = int(random.choice(fits))
            mean, most = float(inertias[:, index].mean()), float(weights[index])
            return _Place(cad, index, mean, most, tuple(float(effort) for effort in rated))


def _shows(wanted: Wanted, cad: Mechanism, index: int, inertia: Array, weighs: float) -> bool:
    joint = cad.joints[index]
    turns, names = joint.kind == "revolute", wanted.names
    if not (inertia.min() > LIGHT and inertia.max() < HEAVY):
        return False
    if any(name in (*PULLED, *SWINGING) for name in names):
        return turns and weighs > WEIGHS
    if "parallelogram" in names:  # of the joint behind it, only weight tells
        pairs = parallel(cad)
        return index in pairs or (index - 1 in pairs and weighs > WEIGHS)
    if any(name in FREE for name in names):
        return weighs < 1e-3
    if any(name in PLUMB for name in names):
        return turns and index == 0
    return turns or weighs < 1e-3 or not any(name in TURNING for name in names)


def _sensors(random: np.random.Generator, rated: float, ratio: float) -> Sensors:
    noise = rated * random.uniform(0.0008, 0.002)
    counts = 2.0 ** random.integers(20, 23)
    return Sensors(
        white=noise * random.uniform(0.6, 1.0),
        slow=noise * random.uniform(0.2, 0.7),
        corner=random.uniform(60.0, 150.0),
        flicker=noise * random.uniform(0.1, 0.4),
        count=2 * np.pi / (counts * ratio),
        jumpy=random.uniform(3e-9, 9e-9),
        effort_step=0.001 * rated if random.random() < 0.25 else 0.0,
        jitter=random.uniform(0.0, 0.01) if random.random() < 0.5 else 0.0,
    )
