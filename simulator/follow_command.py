"""`sweepid follow SCENARIO PATH`: path error of a virtual machine with torque feed-forwards, as JSON."""

from pathlib import Path as File
from typing import Annotated

import numpy as np
import typer
from pydantic import BaseModel, ConfigDict, Field, RootModel, ValidationError

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


def follow_path(
    scenario: Annotated[File, typer.Argument(help="Scenario file (config/scenarios/*.yaml).")],
    path: Annotated[File, typer.Argument(help="JSON file: gain, position, velocity and feed_forwards.")],
) -> None:
    """Drive a path on the plant under position control, and print {feed-forward: {joint: {rms, peak}}} in rad."""
    try:
        found = _followed(scenario, _read(path))
    except ScenarioError as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(2) from None
    typer.echo(RootModel(found).model_dump_json())


def _read(path: File) -> PathFile:
    try:
        return PathFile.model_validate_json(path.read_bytes())
    except OSError as error:
        raise ScenarioError(f"{path}: cannot be read: {error.strerror}") from None
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise ScenarioError(f"{path}: {'.'.join(map(str, first['loc']))}: {first['msg']}") from None


def _followed(scenario: File, file: PathFile) -> dict[str, dict[str, Followed]]:
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
