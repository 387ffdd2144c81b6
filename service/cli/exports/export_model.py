"""`sweepid export-model SOURCE DIR`: the identified robot as URDF, MJCF and YAML."""

from pathlib import Path
from typing import Annotated

import typer

from service.cli.exports.estimates import SideFile, Source, read_estimate
from service.export import model_of, write_model


def export_model(
    source: Source,
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder to write; must be empty or not exist.")],
    robot: SideFile = None,
) -> None:
    """Write the identified robot as model.urdf, model.xml (MJCF), model.yaml and robot.yaml (side file)."""
    known, estimate, _ = read_estimate(source, robot)
    model = model_of(known, estimate, str(source))
    write_model(folder, model)
    if model.deviation_in_std:
        typer.echo(
            "these base parameters are not physically possible; the model contains the nearest possible ones, "
            f"{model.deviation_in_std:.2g} standard deviations away",
            err=True,
        )
    typer.echo(str(folder))
