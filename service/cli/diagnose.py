"""`sweepid diagnose BUNDLE`: where model and measurement disagree, what is missing, and what to measure next."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import track
from rich.table import Table

from service.cli.identify import write_json
from service.diagnosis import AxisDiagnosis, as_document, diagnose_axis
from service.errors import BadInput
from service.store.bundle import Bundle, read_bundle


def diagnose(
    bundle: Annotated[Path, typer.Argument(help="Directory of the bundle.", show_default=False)],
    axis: Annotated[str | None, typer.Option(help="Diagnose this joint only.")] = None,
    json_to: Annotated[str | None, typer.Option("--json", help="Write JSON here; - is stdout.", metavar="FILE")] = None,
    known: Annotated[
        list[str] | None, typer.Option(help="Effect that the axes are known to have; may be repeated.")
    ] = None,
) -> None:
    """Find where simulation and measurement disagree, and name the missing effect."""
    document = diagnose_bundle(read_bundle(bundle), axis, str(bundle), known or ())
    text = json.dumps(document, indent=2, allow_nan=False)
    if json_to == "-":
        typer.echo(text)
        return
    if json_to is not None:
        write_json(Path(json_to), text)
    print_diagnosis(document, Console())


def diagnose_bundle(bundle: Bundle, axis: str | None, place: str, known: Sequence[str] = ()) -> dict[str, Any]:
    """The document of all axes that were swept, or of one; BadInput if that leaves none."""
    if axis is not None:
        bundle.robot.index(axis)
    swept = {sweep.spec.axis for sweep in bundle.sweeps if sweep.spec.excitation not in ("noise", "standstill")}
    joints = [joint for joint in bundle.robot.joints if joint in swept and axis in (None, joint)]
    if not joints:
        raise BadInput(place, "has no sweep that moves" + ("" if axis is None else f" joint {axis}"))
    console = Console(stderr=True)
    found: list[AxisDiagnosis] = [
        diagnose_axis(bundle.robot, joint, bundle.sweeps, known=known)
        for joint in track(joints, "Axes", console=console, transient=True, disable=not console.is_terminal)
    ]
    return as_document(bundle.robot, found)


def print_diagnosis(document: dict[str, Any], console: Console) -> None:
    """Verdict, gap and effects of each axis, where the gap is, and what to measure next."""
    table = Table(title="Diagnosis; gap on held-out sweeps, RMS")
    for name in ("axis", "verdict", "effects", "before", "after", "noise floor"):
        table.add_column(name, justify="right" if name in ("before", "after", "noise floor") else "left")
    for joint, axis in document["axes"].items():
        names = axis["candidates"] or [effect["effect"] for effect in axis["effects"]]
        gap = axis["gap"]
        table.add_row(
            joint,
            axis["verdict"],
            (" or " if axis["candidates"] else ", ").join(names) or "-",
            *(f"{gap[key]:.4g}" for key in ("before_rms", "after_rms", "noise_floor_rms")),
        )
    console.print(table)
    for joint, axis in document["axes"].items():
        for sentence in axis["sentences"]:
            console.print(sentence)
        for effect in axis["effects"]:
            console.print(f"{joint}: {effect['sentence']}")
            for name, value in effect["parameters"].items():
                console.print(f"  {name} = {value['value']:.4g} ± {value['std']:.2g} {value['unit']}".rstrip())
        if axis["next_experiment"]:
            console.print(f"{joint}: next, {axis['next_experiment']['kind']}. {axis['next_experiment']['reason']}")
