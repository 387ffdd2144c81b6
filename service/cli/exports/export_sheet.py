"""`sweepid export-sheet SOURCE`: what to type into the control."""

from pathlib import Path
from typing import Annotated

import typer

from service.cli.documents import JsonTo, put_json, read_document
from service.cli.exports.estimates import SideFile, Source, read_estimate
from service.export.sheets.load import load_of
from service.export.sheets.making import sheet
from service.export.sheets.supplementary import UPRIGHT
from service.export.sheets.text import as_markdown
from service.results.identified.payload import Payload


def export_sheet(
    source: Source,
    robot: SideFile = None,
    payload: Annotated[
        Path | None, typer.Option(help="Load for KUKA and ABB: JSON file of `sweepid payload`.", metavar="FILE")
    ] = None,
    kuka_upright: Annotated[
        float,
        typer.Option(
            help="Position of the second joint in the URDF, deg, where a KUKA shows A2 = -90 deg.", metavar="DEG"
        ),
    ] = UPRIGHT,
    json_to: JsonTo = None,
) -> None:
    """Tell the identified inertias as the values that controls take, with uncertainty and the place to type them."""
    known, estimate, bundle = read_estimate(source, robot)
    poses = None if bundle is None else {sweep.spec.id: sweep.spec.pose for sweep in bundle.sweeps}
    made = sheet(known, estimate, str(source), poses, kuka_upright)
    load = None if payload is None else load_of(read_document(payload, Payload, "--payload"))
    text = as_markdown(made, load)
    if not put_json(made, json_to):
        typer.echo(text)
