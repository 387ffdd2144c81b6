"""A path of the whole robot under position control with torque feed-forward: deviation of the motors from it.

Each axis is controlled like on a control: a proportional position controller, once per cycle, gives the speed
set-point of the PI controller of the drive in the scenario. The feed-forward is added to its torque. At the start
the drive holds the robot, so only the change since then is fed forward. The links are coupled, as in `coupled`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path as File

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from simulator.plant import CoupledTrains, Plant
from simulator.scenario import STEP, Scenario, ScenarioError, load_scenario
from simulator.waveform import Array


@dataclass(frozen=True)
class Path:
    """Positions and velocities (n, all joints) at the ends of cycles of 1 ms, rad and rad/s; it starts from rest."""

    position: Array
    velocity: Array

    def checked(self, scenario: Scenario) -> "Path":
        """Raises ScenarioError unless it is a path of this robot that moves only joints with a drive."""
        wanted = (len(self.position), len(scenario.joints))
        if len(self.position) < 2 or self.position.shape != wanted or self.velocity.shape != wanted:
            raise ScenarioError(f"a path needs positions and velocities of {len(scenario.joints)} joints, 2 or more")
        if not (np.isfinite(self.position).all() and np.isfinite(self.velocity).all()):
            raise ScenarioError("the path holds a number that is not finite")
        for number, joint in enumerate(scenario.joints):
            if joint not in scenario.axes and np.ptp(self.position[:, number]) > 0:
                raise ScenarioError(f"{joint} has no drive in this scenario and cannot follow a path")
        return self


def follow(scenario: Scenario, path: Path, gain: float, effort: Array | None = None) -> dict[str, Array]:
    """Position minus that of the path (n,) of each driven joint, rad; `gain` of the position controller, 1/s.

    `effort` (n, all joints): torque that is fed forward, N m on the joint side. Raises ScenarioError if it does not
    fit.
    """
    path.checked(scenario)
    if effort is not None and (effort.shape != path.position.shape or not np.isfinite(effort).all()):
        raise ScenarioError(f"the feed-forward is not {len(path.position)} rows of {len(scenario.joints)} numbers")
    trains = CoupledTrains(scenario, STEP)
    trains.stand(path.position[0])
    plant = Plant(trains.axes, [scenario.driven(joint).control for joint in trains.joints], scenario.measurement)
    plant.trains = trains
    for row in range(len(trains.joints)):
        plant.release(row)
    driven = [scenario.joints.index(joint) for joint in trains.joints]
    wanted, speed = path.position[:, driven], path.velocity[:, driven]
    given = np.zeros_like(wanted) if effort is None else (effort - effort[0])[:, driven]
    error = np.zeros_like(wanted)
    for cycle in range(1, len(wanted)):
        setpoint = speed[cycle] - gain * error[cycle - 1]
        plant.advance(setpoint[None], given[cycle][None])
        error[cycle] = trains.position[0] - wanted[cycle]
    return {joint: error[:, row] for row, joint in enumerate(trains.joints)}


def read_rows(rows: Sequence[Sequence[float]], what: str) -> Array:
    """Numbers (n, joints) of a file. Raises ScenarioError if rows differ in length."""
    if len({len(row) for row in rows}) > 1:
        raise ScenarioError(f"{what}: rows of different lengths")
    return np.array(rows, dtype=float)


Rows = tuple[tuple[float, ...], ...]


class PathFile(BaseModel):
    """`gain` of the position controllers, 1/s; rows of all joints, one per ms, SI; feed-forwards by name, [] for
    none.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    gain: float = Field(gt=0, le=100)
    position: Rows
    velocity: Rows
    feed_forwards: dict[str, Rows]


class Followed(BaseModel):
    """Path error of a joint, rad."""

    rms: float
    peak: float


def read_path(path: File) -> PathFile:
    """ScenarioError for a file that is none."""
    try:
        return PathFile.model_validate_json(path.read_bytes())
    except OSError as error:
        raise ScenarioError(f"{path}: cannot be read: {error.strerror}") from None
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise ScenarioError(f"{path}: {'.'.join(map(str, first['loc']))}: {first['msg']}") from None


def followed(scenario: File, file: PathFile) -> dict[str, dict[str, Followed]]:
    """By feed-forward and joint."""
    machine = load_scenario(scenario)
    path = Path(read_rows(file.position, "position"), read_rows(file.velocity, "velocity"))
    found: dict[str, dict[str, Followed]] = {}
    for name, rows in file.feed_forwards.items():
        errors = follow(machine, path, file.gain, read_rows(rows, name) if rows else None)
        found[name] = {
            joint: Followed(rms=float(np.sqrt(np.mean(error**2))), peak=float(np.abs(error).max()))
            for joint, error in errors.items()
        }
    return found
