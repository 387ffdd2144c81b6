"""`sweepid export-sheet SOURCE`: what to type into the control."""

from pathlib import Path
from typing import Annotated

import typer

from service.cli.documents import JsonTo, put_json, read_document
from service.cli.identify import identify_bundle
from service.configuration import read_robot
from service.errors import BadInput
from service.export.sheet import sheet
from service.export.sheet_text import as_markdown
from service.store.bundle import read_bundle


def export_sheet(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="BUNDLE|ESTIMATE",
            help="Directory of a bundle, or file of `sweepid identify --json`.",
            show_default=False,
        ),
    ],
    robot: Annotated[Path | None, typer.Option(help="Side file of the robot, for an ESTIMATE.")] = None,
    payload: Annotated[
        Path | None, typer.Option(help="Load for KUKA and ABB: JSON file of `sweepid payload`.", metavar="FILE")
    ] = None,
    json_to: JsonTo = None,
) -> None:
    """Tell the identified inertias as the values that controls take, with uncertainty and the place to type them."""
    if source.is_dir():
        bundle = read_bundle(source)
        poses = {sweep.spec.id: sweep.spec.pose for sweep in bundle.sweeps}
        made = sheet(bundle.robot, identify_bundle(bundle, None, str(source)), str(source), poses)
    elif robot is None:
        raise BadInput("--robot", "is needed with an estimate, which does not hold the robot's gears")
    else:
        made = sheet(read_robot(robot), read_document(source), str(source))
    text = as_markdown(made, read_document(payload) if payload else None)
    if not put_json(made, json_to):
        typer.echo(text)
