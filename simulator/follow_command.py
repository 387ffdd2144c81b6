"""`sweepid drive follow SCENARIO PATH`: path error of a virtual machine with torque feed-forwards, as JSON."""

from pathlib import Path
from typing import Annotated

import typer


def follow_path(
    scenario: Annotated[Path, typer.Argument(help="Scenario file (config/scenarios/*.yaml).")],
    path: Annotated[Path, typer.Argument(help="JSON file: gain, position, velocity and feed_forwards.")],
) -> None:
    """Drive a path on the plant under position control, and print {feed-forward: {joint: {rms, peak}}} in rad."""
    from pydantic import RootModel

    from simulator.follow import followed, read_path
    from simulator.scenario import ScenarioError

    try:
        found = followed(scenario, read_path(path))
    except ScenarioError as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(2) from None
    typer.echo(RootModel(found).model_dump_json())
