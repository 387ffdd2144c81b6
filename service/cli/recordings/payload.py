"""`sweepid payload BEFORE AFTER`: mass, centre and inertia of what was mounted on the last link in between."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from service.cli.documents import JsonTo, put_json
from service.cli.progress_indicator import waiting
from service.cli.recordings.gains_file import read_gains
from service.errors import BadInput
from service.identification.payloads.document import payload_document
from service.identification.payloads.payload import payload
from service.results.identified.payload import Payload
from service.store.files.bundle import Bundle, read_bundle


def payload_command(
    before: Annotated[Path, typer.Argument(help="Bundle measured without the payload.", show_default=False)],
    after: Annotated[Path, typer.Argument(help="Bundle of the same motions with it.", show_default=False)],
    gains: Annotated[Path | None, typer.Option("--torque-gain", help="JSON file of `sweepid torque-gain`.")] = None,
    json_to: JsonTo = None,
) -> None:
    """Identify a payload on the last link from the same motions with and without it."""
    with waiting("identifying the payload"):
        document = payload_of(read_bundle(before), read_bundle(after), str(after), gains)
    if put_json(document, json_to):
        return
    _print(document, Console())


def payload_of(before: Bundle, after: Bundle, place: str, gains: Path | None = None) -> Payload:
    """The document; BadInput where the bundles are not of one robot or have no motion in common."""
    if (before.robot.description, before.robot.urdf_text) != (after.robot.description, after.robot.urdf_text):
        raise BadInput(place, f"is not of robot {before.robot.name} of the first bundle: robot file or URDF differs")
    found = payload(before.robot, before.sweeps, after.sweeps, read_gains(gains) if gains else None)
    return payload_document(before.robot, found)


def _print(document: Payload, console: Console) -> None:
    table = Table(title=f"Payload on {document.link}, in the frame of {document.frame}, SI")
    table.add_column("")
    for name in ("value", "std", "std with torque constants"):
        table.add_column(name, justify="right")
    rows = [("mass", document.mass)]
    rows += [(f"center {name}", figure) for name, figure in document.center.items()]
    rows += [(f"{name} about the center", figure) for name, figure in document.inertia.items()]
    for name, figure in rows:
        sizes = ("-" if size is None else f"{size:.4g}" for size in (figure.value, figure.std, figure.std_total))
        table.add_row(name, *sizes)
    console.print(table)
    for sentence in document.sentences:
        console.print(sentence)
