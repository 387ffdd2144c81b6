"""Mass, centre and inertia of what was mounted on the last link in between."""

from pathlib import Path

from rich.console import Console
from rich.table import Table

from service.cli.recordings.gains_file import read_gains
from service.errors import BadInput
from service.identification.payloads.document import payload_document
from service.identification.payloads.payload import payload
from service.results.identified.payload import Payload
from service.store.files.bundle import Bundle


def payload_of(before: Bundle, after: Bundle, place: str, gains: Path | None = None) -> Payload:
    """The document; BadInput where the bundles are not of one robot or have no motion in common."""
    if (before.robot.description, before.robot.urdf_text) != (after.robot.description, after.robot.urdf_text):
        raise BadInput(place, f"is not of robot {before.robot.name} of the first bundle: robot file or URDF differs")
    found = payload(before.robot, before.sweeps, after.sweeps, read_gains(gains) if gains else None)
    return payload_document(before.robot, found)


def print_payload(document: Payload, console: Console) -> None:
    """The ten parameters, and what is not known, in words."""
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
