"""`sweepid truth SCENARIO --poses FILE.json`: the real inertias of a virtual machine, as JSON on stdout."""

import json
from pathlib import Path
from typing import Annotated

import typer

from simulator.scenario import ScenarioError
from simulator.truth import truth as true_inertias


def truth(
    scenario: Annotated[Path, typer.Argument(help="Scenario file (config/scenarios/*.yaml).")],
    poses: Annotated[Path, typer.Option(help="JSON file: a list of poses, each the positions of all joints in rad.")],
) -> None:
    """Print {joint: [total inertia in kg m^2, one a pose]} of a virtual machine."""
    try:
        found = true_inertias(scenario, _read_poses(poses))
    except ScenarioError as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(2) from None
    typer.echo(json.dumps(found))


def _read_poses(path: Path) -> list[list[float]]:
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        return [[float(position) for position in pose] for pose in data]
    except (OSError, ValueError, TypeError) as error:
        raise ScenarioError(f"{path}: not a list of poses: {error}") from None
