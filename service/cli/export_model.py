"""`sweepid export-model SOURCE DIR`: the identified robot as URDF, MJCF and YAML."""

from pathlib import Path
from typing import Annotated

import typer

from service.cli.documents import read_document
from service.cli.identify import identify_bundle
from service.configuration import read_robot
from service.errors import BadInput
from service.export import identified_model, write_model
from service.robot import Robot
from service.store.bundle import read_bundle


def export_model(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="BUNDLE|ESTIMATE",
            help="Directory of a bundle, or file of `sweepid identify --json`.",
            show_default=False,
        ),
    ],
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder to write; must be empty or not exist.")],
    robot: Annotated[Path | None, typer.Option(help="Side file of the robot, for an ESTIMATE.")] = None,
) -> None:
    """Write the identified robot as model.urdf, model.xml (MJCF), model.yaml and robot.yaml (side file)."""
    if source.is_dir():
        bundle = read_bundle(source)
        known, document = bundle.robot, identify_bundle(bundle, None, str(source))
    else:
        known, document = _robot_of(robot), read_document(source)
    model = identified_model(known, document, str(source))
    write_model(folder, model)
    if model.deviation_in_std:
        typer.echo(
            f"no robot can have exactly these base parameters; the one written is {model.deviation_in_std:.2g} "
            "standard deviations away",
            err=True,
        )
    typer.echo(str(folder))


def _robot_of(side_file: Path | None) -> Robot:
    if side_file is None:
        raise BadInput("--robot", "is needed with an estimate, which does not hold the robot's geometry")
    return read_robot(side_file)
