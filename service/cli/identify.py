"""`sweepid identify BUNDLE`: the paper's Table 1, the base parameters and their quality from recorded sweeps."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import track
from rich.table import Table

from service.errors import BadInput
from service.estimation import estimate_document
from service.identification import Spectrum, spectrum
from service.store.bundle import Bundle, read_bundle

_ROWS = (
    ("reference - measurement", "reference_measured"),
    ("identified - measurement", "identified_measured"),
    ("reference - identified (workspace)", "reference_identified"),
)


def identify(
    bundle: Annotated[Path, typer.Argument(help="Directory of the bundle.", show_default=False)],
    axis: Annotated[str | None, typer.Option(help="Use the sweeps of this joint only.")] = None,
    json_to: Annotated[str | None, typer.Option("--json", help="Write JSON here; - is stdout.", metavar="FILE")] = None,
) -> None:
    """Identify a robot from the sweeps of a bundle."""
    document = identify_bundle(read_bundle(bundle), axis, str(bundle))
    text = json.dumps(document, indent=2, allow_nan=False)
    if json_to == "-":
        typer.echo(text)
        return
    if json_to is not None:
        write_json(Path(json_to), text)
    print_estimate(document, Console())


def identify_bundle(bundle: Bundle, axis: str | None, place: str) -> dict[str, Any]:
    """The estimate as in DESIGN.md, of all sweeps or of those of one joint; BadInput if that leaves none."""
    if axis is not None:
        bundle.robot.index(axis)
    sweeps = [sweep for sweep in bundle.sweeps if axis in (None, sweep.spec.axis) and sweep.spec.shows_inertia]
    if not sweeps:
        of_joint = "" if axis is None else f" of joint {axis}"
        raise BadInput(place, f"has no sweep{of_joint} with sines or a trajectory")
    console = Console(stderr=True)
    spectra: list[Spectrum] = [
        spectrum(bundle.robot, sweep)
        for sweep in track(sweeps, "Sweeps", console=console, transient=True, disable=not console.is_terminal)
    ]
    return estimate_document(bundle.robot, spectra)


def print_estimate(document: dict[str, Any], console: Console) -> None:
    """Table 1 of the paper for this robot, then the base parameters with standard deviation."""
    axes: dict[str, Any] = document["axes"]
    table = Table(title="RMSE of the axis inertias in percent")
    table.add_column("")
    for joint in axes:
        table.add_column(joint, justify="right")
    for label, key in _ROWS:
        table.add_row(label, *(_percent(axis["rmse_percent"][key]) for axis in axes.values()))
    table.add_row("sweeps", *(str(len(axis["inertia"])) for axis in axes.values()), style="dim")
    console.print(table)

    table = Table(title="Base parameters, SI, about the joints' axes")
    table.add_column("parameter", overflow="fold")
    table.add_column("value", justify="right")
    table.add_column("std", justify="right")
    for parameter in document["base_parameters"]:
        table.add_row(parameter["name"], f"{parameter['value']:.5g}", _number(parameter["std"]))
    console.print(table)
    _print_free_records(axes, console)
    console.print(f"Condition number of the observation matrix: {_number(document['condition_number'])}")


def _print_free_records(axes: dict[str, Any], console: Console) -> None:
    """What else was found in records without lines, which are fitted one by one."""
    records = [(joint, sweep) for joint, axis in axes.items() for sweep in axis["inertia"] if "terms" in sweep]
    if not records:
        return
    table = Table(title="Records without lines, SI")
    for name in ("axis", "sweep", "term"):
        table.add_column(name)
    for name in ("value", "std"):
        table.add_column(name, justify="right")
    for joint, sweep in records:
        terms = {"inertia": {"value": sweep["value"], "std": sweep["std"]}, **sweep["terms"]}
        for name, term in terms.items():
            table.add_row(joint, sweep["sweep"], name, f"{term['value']:.5g}", _number(term["std"]))
    console.print(table)


def write_json(path: Path, text: str) -> None:
    """Write a result where a person asked for it; BadInput if that cannot be."""
    try:
        path.write_text(text + "\n", encoding="utf-8")
    except OSError as error:
        raise BadInput(str(path), f"cannot be written: {error.strerror or error}") from None


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _number(value: float | None) -> str:
    return "undetermined" if value is None else f"{value:.3g}"
