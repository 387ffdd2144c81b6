"""The sweeps of a case as one npz file: quick to read again, and without a word of what is hidden."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from service.model import Recording, Robot, RobotDescription, Sweep, SweepSpec, build_robot

COLUMNS = ("time", "effort", "velocity", "position", "velocity_setpoint")


def save(path: Path, robot: Robot, joint: str, sweeps: Sequence[Sweep]) -> None:
    """All sweeps of a case are equally long."""
    described = {
        "robot": robot.description.model_dump(mode="json"),
        "urdf": robot.urdf_text,
        "joint": joint,
        "specs": [sweep.spec.model_dump(mode="json") for sweep in sweeps],
    }
    records = [sweep.recording for sweep in sweeps]
    columns = {c: np.array([getattr(r, c) for r in records]) for c in COLUMNS if getattr(records[0], c) is not None}
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".partial.npz")
    np.savez(partial, described=np.array(json.dumps(described)), **columns)
    partial.replace(path)


def load(path: Path) -> tuple[Robot, str, list[Sweep]]:
    """Robot, joint and sweeps, as they were."""
    with np.load(path) as kept:
        described = json.loads(str(kept["described"]))
        columns = {c: kept[c] for c in COLUMNS if c in kept}
    robot = build_robot(RobotDescription.model_validate(described["robot"]), described["urdf"])
    specs = [SweepSpec.model_validate(spec) for spec in described["specs"]]
    sweeps = [Sweep(spec, Recording(**{c: values[k] for c, values in columns.items()})) for k, spec in enumerate(specs)]
    return robot, described["joint"], sweeps
