"""`sweepid plan-trajectories ROBOT`: let the service design trajectories that move several axes at once."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from service.cli.address import DEFAULT_URL, Url
from service.cli.campaign.planned import ConfirmCell, ConfirmRobot, robot_number, tell_subject
from service.cli.progress_indicator import waiting
from service.client import Json, ServiceClient


def plan_trajectories(
    axes: Annotated[str, typer.Option(help="Joints to move at once, separated by commas; the others stand at home.")],
    robot: Annotated[
        Path | None,
        typer.Argument(
            help="Side file of the robot, e.g. config/robots/max100-class.yaml; default: that of the machine."
        ),
    ] = None,
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
    cell: Annotated[
        str | None, typer.Option(help="Name of the cell around the robot; default: that of the machine.")
    ] = None,
    confirm_robot: ConfirmRobot = None,
    confirm_cell: ConfirmCell = None,
    url: Url = DEFAULT_URL,
) -> None:
    """Plan exciting trajectories. Nothing moves. Prints the number of the plan."""
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
        number = robot_number(client, robot)
        with waiting("planning: trajectories and collision-free paths are computed"):
            planned = client.add_plan(
                request | {"robot_id": number}, confirm_robot=confirm_robot, confirm_cell=confirm_cell
            )
    tell_subject(planned)
    document = planned["document"]
    conditions = ", ".join(f"{condition:.0f}" for condition in document["condition"])
    sys.stderr.write(f"condition numbers {conditions}; {planned['expected_time'] / 60:.0f} min\n")
    sys.stdout.write(f"{planned['id']}\n")
