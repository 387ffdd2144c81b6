"""The file of a path with torque feed-forwards, followed by a virtual machine."""

from pathlib import Path as File

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from simulator.follow import Path, follow, read_rows
from simulator.scenario import ScenarioError, load_scenario

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
