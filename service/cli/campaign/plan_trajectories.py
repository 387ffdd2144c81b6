"""`sweepid plan-trajectories ROBOT`: let the service design trajectories that move several axes at once."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from service.cli.address import DEFAULT_URL, Url
from service.cli.progress_indicator import waiting
from service.client import Json, ServiceClient
from service.configuration import read_robot


def plan_trajectories(
    robot: Annotated[Path, typer.Argument(help="Side file of the robot, e.g. config/robots/max100-class.yaml.")],
    axes: Annotated[str, typer.Option(help="Joints to move at once, separated by commas; the others stand at home.")],
    trajectories: Annotated[int | None, typer.Option(help="How many (usually 3).")] = None,
    period: Annotated[float | None, typer.Option(help="s, of the fundamental (usually 10).")] = None,
    harmonics: Annotated[int | None, typer.Option(help="How many of the fundamental (usually 5).")] = None,
    velocity: Annotated[
        float | None, typer.Option(help="rad/s (m/s): largest sum of the amplitudes of an axis.")
    ] = None,
    acceleration: Annotated[float | None, typer.Option(help="rad/s^2 (m/s^2).")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of the random trajectories.")] = None,
    sweeps: Annotated[
        int | None, typer.Option(help="Campaign whose sweeps are combined with the trajectories.")
    ] = None,
    cell: Annotated[str | None, typer.Option(help="Name of the cell around the robot.")] = None,
    url: Url = DEFAULT_URL,
) -> None:
    """Plan exciting trajectories. Nothing moves. Prints the number of the plan."""
    known = read_robot(robot)
    options: Json = {
        "trajectories": trajectories,
        "period": period,
        "harmonics": harmonics,
        "velocity": velocity,
        "acceleration": acceleration,
        "seed": seed,
        "sweeps": sweeps,
        "cell": cell,
    }
    request: Json = {name: value for name, value in options.items() if value is not None}
    request |= {"kind": "trajectory", "axes": [name.strip() for name in axes.split(",") if name.strip()]}
    with ServiceClient(url) as client:
        stored = client.add_robot(known.description.model_dump(mode="json"), known.urdf_text)
        with waiting("planning: trajectories and collision-free paths are computed"):
            planned = client.add_plan(request | {"robot_id": stored["id"]})
    document = planned["document"]
    conditions = ", ".join(f"{condition:.0f}" for condition in document["condition"])
    sys.stderr.write(f"condition numbers {conditions}; {planned['expected_time'] / 60:.0f} min\n")
    sys.stdout.write(f"{planned['id']}\n")
