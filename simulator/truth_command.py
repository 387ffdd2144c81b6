"""`sweepid drive truth SCENARIO`: true parameters of a virtual machine, as JSON on stdout: its inertias, or its hidden
effect.
"""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer


def truth(
    scenario: Annotated[Path, typer.Argument(help="Scenario file (config/scenarios/*.yaml).")],
    poses: Annotated[
        Path | None, typer.Option(help="JSON file: a list of poses, each the positions of all joints in rad.")
    ] = None,
    hide: Annotated[int | None, typer.Option(min=0, help="Seed given to `sweepid drive --hide`.")] = None,
) -> None:
    """Print {joint: [total inertia in kg m^2, one per pose]}, or for a seed the axis, effect and parameters that it
    hides.
    """
    from simulator.hidden import hide as hidden_in
    from simulator.rigid_body import truth as true_inertias
    from simulator.scenario import ScenarioError, load_scenario

    try:
        if hide is not None and poses is None:
            found: object = asdict(hidden_in(load_scenario(scenario), hide)[1])
        elif poses is not None and hide is None:
            found = true_inertias(scenario, _read_poses(poses))
        else:
            raise ScenarioError(
                "give exactly one of --poses and --hide: --poses FILE prints the inertias in these poses, --hide SEED "
                "the hidden effect"
            )
    except ScenarioError as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(2) from None
    typer.echo(json.dumps(found))


def _read_poses(path: Path) -> list[list[float]]:
    from simulator.scenario import ScenarioError

    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        return [[float(position) for position in pose] for pose in data]
    except (OSError, ValueError, TypeError, OverflowError, RecursionError) as error:
        raise ScenarioError(f"{path}: not a list of poses: {error}") from None
