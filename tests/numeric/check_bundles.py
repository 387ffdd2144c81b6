"""Sound bundles for the check of the data: blind machines, measured and described in the ways in which real ones are.

Whatever physics a machine hides, its data are sound. CAD is off by up to 18 % in most bundles, numbers have 32 bits in
half of them, records end with their window in half, a third has no holds, a fifth has the paper's four sweeps only.
"""

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from service.recording import Recording, Sweep, SweepSpec
from service.robot import Robot, build_robot
from service.store.files.bundle import Bundle
from tests.numeric.blind.cases import Case, Design, Kind, scene
from tests.numeric.blind.effects import CATALOGUE, OUTSIDE, PAIRS

HOLDING = 3.0  # s
SHAPES = ("full", "full", "full", "full", "paper")


@dataclass(frozen=True)
class Sound:
    """A sound bundle of one axis that was swept, and what is hidden in it."""

    bundle: Bundle
    joint: str
    hidden: tuple[str, ...]


def sound(seed: int) -> Sound:
    """Everything random comes from the seed."""
    random = np.random.default_rng([seed, 20])
    hidden = [(), *((name,) for name in (*CATALOGUE, *OUTSIDE)), *PAIRS][seed % (1 + len(CATALOGUE) + len(OUTSIDE))]
    if random.random() < 0.2 and hidden:
        hidden = PAIRS[int(random.integers(len(PAIRS)))]
    design = Design(str(random.choice(SHAPES)))
    size = str(random.choice(["small", "medium", "large"]))
    one = scene(Case(seed, Kind.SINGLE if hidden else Kind.NONE, tuple(hidden), size, design, (seed, 21)))
    robot = _wrong_cad(random, one.robot) if random.random() < 0.75 else one.robot
    sweeps = list(one.evidence().sweeps)
    if random.random() < 0.67:
        sweeps = _with_holds(random, robot, sweeps)
    if random.random() < 0.5:
        sweeps = [_trimmed(sweep) for sweep in sweeps]
    if random.random() < 0.5:
        sweeps = [single(sweep) for sweep in sweeps]
    return Sound(Bundle(robot, tuple(sweeps)), one.joint, tuple(hidden))


def changed(sweep: Sweep, **columns: np.ndarray) -> Sweep:
    """The sweep with other columns."""
    return Sweep(sweep.spec, replace(sweep.recording, **columns))


def single(sweep: Sweep) -> Sweep:
    """Numbers of 32 bits, and no set-point."""
    columns = {field.name: getattr(sweep.recording, field.name) for field in fields(Recording)}
    some = {name: column for name, column in columns.items() if column is not None and name != "velocity_setpoint"}
    rounded = {name: column.astype(np.float32).astype(np.float64) for name, column in some.items() if name != "time"}
    return Sweep(sweep.spec, Recording(**(some | rounded)))


def _trimmed(sweep: Sweep) -> Sweep:
    """The record ends with its measured window."""
    spec = sweep.spec
    if spec.period is None or spec.periods is None:
        return sweep
    last = round((spec.measure_from + spec.period * spec.periods) * spec.sample_rate)
    columns = {field.name: getattr(sweep.recording, field.name) for field in fields(Recording)}
    cut: dict[str, Any] = {n: None if column is None else column[:last] for n, column in columns.items()}
    return Sweep(spec, Recording(**cut))


def _with_holds(random: np.random.Generator, robot: Robot, sweeps: Sequence[Sweep]) -> list[Sweep]:
    """Two holds before the first sweep: what the sensors tell of an axis that stands."""
    first = sweeps[0].spec
    rated, index = robot.axis(first.axis).rated_effort, robot.index(first.axis)
    count = round(HOLDING * first.sample_rate)
    quiet = sweeps[0].recording.effort
    noise = float(np.std(np.diff(quiet, 2))) / np.sqrt(6)
    held: list[Sweep] = []
    for repeat in range(2):
        spec = SweepSpec(
            id=f"hold-{repeat}",
            axis=first.axis,
            pose=first.pose,
            offset_velocity=0.0,
            excitation="standstill",
            sample_rate=first.sample_rate,
            started_at=first.started_at,
            repeat=repeat,
            block="hold",
        )
        effort = quiet[0] + noise * random.standard_normal(count)
        held.append(
            Sweep(
                spec,
                Recording(
                    time=np.arange(count) / first.sample_rate,
                    effort=np.round(effort / (0.001 * rated)) * 0.001 * rated,
                    velocity=5e-6 * random.standard_normal(count),
                    position=first.pose[index] + 2e-8 * random.standard_normal(count),
                ),
            )
        )
    return [*held, *sweeps]


def _wrong_cad(random: np.random.Generator, robot: Robot) -> Robot:
    """Masses, centres and inertias off by 10 to 18 %, each its own way."""
    root = ET.fromstring(robot.urdf_text)
    off = random.uniform(0.10, 0.18)
    for link in root.findall("link"):
        for inertial in link.findall("inertial"):
            mass, inertia = (1 + off * random.choice([-1.0, 1.0]) * random.uniform(0.5, 1.0) for _ in range(2))
            for element in inertial.iter("mass"):
                element.set("value", repr(float(element.attrib["value"]) * float(mass)))
            for element in inertial.iter("inertia"):
                for key, value in element.attrib.items():
                    element.set(key, repr(float(value) * float(inertia)))
            for element in inertial.iter("origin"):
                where = [float(float(x) * (1 + off * random.uniform(-1, 1))) for x in element.attrib["xyz"].split()]
                element.set("xyz", " ".join(map(repr, where)))
    return build_robot(robot.description, ET.tostring(root, encoding="unicode"))
