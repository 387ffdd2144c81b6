"""`sweepid export`: recordings and results for other programs and controls."""

from __future__ import annotations

import sys
import tempfile
import zipfile
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import sweepid
from service import BadInput
from service.cli.terminal import DEFAULT_URL, BundleArg, JsonTo, SideFile, Source, Url, connect, put_json, waiting

if TYPE_CHECKING:
    from service.model import Robot
    from service.model.results.estimate import Estimate
    from service.planning.documents import PlanDocument
    from service.store.files.bundle import Bundle


def campaign_number(text: str) -> int:
    """The number of a campaign; an error tells the other commands that export."""
    if text.isascii() and text.isdecimal() and int(text) >= 1:
        return int(text)
    raise typer.BadParameter(
        f"{text!r} is not the number of a campaign. For the values of a control use `sweepid export sheet`, "
        "for URDF and MJCF `sweepid export model`"
    )


def export_bundle(
    campaign: Annotated[int, typer.Argument(parser=campaign_number, help="Number of a campaign.")],
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder to write; must be empty or not exist.")],
    url: Url = DEFAULT_URL,
) -> None:
    """Write the recorded sweeps of a campaign as a bundle. Prints the folder."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise BadInput(str(folder), "exists already and is not an empty folder")
    with connect(url) as client, tempfile.TemporaryDirectory() as temporary:
        archive = Path(temporary) / "bundle.zip"
        with waiting("the service packs the recordings"):
            client.export_bundle(campaign, archive)
        with zipfile.ZipFile(archive) as content:
            content.extractall(folder)
    sys.stdout.write(f"{folder}\n")


def export_model(
    source: Source,
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder to write; must be empty or not exist.")],
    robot: SideFile = None,
) -> None:
    """Write the identified robot as model.urdf, model.xml (MJCF), model.yaml and robot.yaml (side file)."""

    known, estimate, _ = read_estimate(source, robot)
    model = sweepid.export(known, estimate, folder, place=str(source))
    for warning in model.warnings:
        typer.echo(warning, err=True)
    typer.echo(str(folder))


def export_sheet(
    source: Annotated[
        Path | None,
        typer.Argument(help="Bundle, or JSON file of an estimate. Without it: the load alone.", metavar="SOURCE"),
    ] = None,
    robot: SideFile = None,
    payload: Annotated[
        Path | None, typer.Option(help="Load for the control: JSON file of `sweepid estimate payload`.", metavar="FILE")
    ] = None,
    kuka_upright: Annotated[
        float | None,
        typer.Option(
            help="Position of the second joint in the URDF, deg, where a KUKA shows A2 = -90 deg (usually -90).",
            metavar="DEG",
        ),
    ] = None,
    json_to: JsonTo = None,
) -> None:
    """Tell the identified inertias as the values that controls take, with uncertainty and the place to type them."""
    from service.formats.export.sheets.inertias import UPRIGHT, load_of
    from service.formats.export.sheets.making import sheet
    from service.formats.export.sheets.text import as_markdown, load_page
    from service.model.results.payload import Payload
    from sweepid.files import read_document

    load = None if payload is None else load_of(read_document(payload, Payload, "--payload"))
    if source is None:
        if load is None:
            raise BadInput("SOURCE", "is missing: give a bundle, an estimate, or --payload for a load alone")
        typer.echo(load_page(load))
        return
    known, estimate, bundle = read_estimate(source, robot)
    poses = None if bundle is None else {sweep.spec.id: sweep.spec.pose for sweep in bundle.sweeps}
    made = sheet(known, estimate, str(source), poses, UPRIGHT if kuka_upright is None else kuka_upright)
    if not put_json(made, json_to):
        typer.echo(as_markdown(made, load))


def export_path(
    plan: Annotated[Path, typer.Argument(help="File that `sweepid plan --out` wrote.", show_default=False)],
    robot: Annotated[Path, typer.Option(help="Side file of the plan's robot.", show_default=False)],
    cell: Annotated[Path, typer.Option(help="File of the plan's cell.", show_default=False)],
    control: Annotated[Path, typer.Option(help="File of the CNC: axes, cycle, trace.", show_default=False)],
    out: Annotated[Path, typer.Option(help="Folder to write; must be empty or not exist.", show_default=False)],
) -> None:
    """Write every sweep of a plan as table (.csv) and Sinumerik part program (.MPF), and the mapping for the traces."""
    from service.machine.paths.sweep_paths import export_paths, read_control
    from service.model.configuration import read_cell, read_robot

    document = read_plan(plan)
    known = read_robot(robot)
    count = export_paths(out, document, known, read_cell(cell), read_control(control, known))
    typer.echo(f"{out}: {count} sweep{'s' if count > 1 else ''} of {known.name}", err=True)


def export_recording(
    bundle: BundleArg,
    out: Annotated[
        Path,
        typer.Argument(
            help="New file: .mf4 (MDF4), .h5 or .hdf5 (HDF5), .mcap (MCAP), .csv (one sweep); without suffix a bundle "
            "whose samples are CSV.",
            show_default=False,
        ),
    ],
    sweep: Annotated[list[str] | None, typer.Option(help="Id of a sweep; repeatable. Default: all.")] = None,
    began: Annotated[
        str | None,
        typer.Option(help="Start of the campaign, as 2026-11-24T08:00:00+01:00; a bundle does not contain it."),
    ] = None,
) -> None:
    """Write recordings of a bundle as MDF4, HDF5, MCAP or CSV."""
    from service.formats.export.recordings import write_recordings
    from service.store.files.bundle import read_bundle

    moment = None if began is None else _moment(began)
    measured = read_bundle(bundle)
    with waiting("writing"):
        written = write_recordings(out, measured, sweep or (), moment)
    typer.echo(f"{out}: {len(written)} sweep{'s' if len(written) > 1 else ''} of {measured.robot.name}", err=True)


def _moment(text: str) -> datetime:
    """BadInput unless it is a time with its zone, from 1970 on, where all formats can tell it."""
    try:
        moment = datetime.fromisoformat(text)
    except ValueError as error:
        raise BadInput("--began", f"{text!r} is not a time: {error}") from None
    if moment.tzinfo is None or moment < datetime.fromtimestamp(0, UTC):
        raise BadInput("--began", f"{text!r} has no zone (as +01:00, or Z), or lies before 1970")
    return moment


def read_estimate(source: Path, side_file: Path | None) -> tuple[Robot, Estimate, Bundle | None]:
    """Robot, estimate, and the bundle that it was made of here; None: it was read from a file."""
    from service.model.configuration import read_text
    from service.model.results.estimate import Estimate
    from sweepid.files import LARGEST, read_document

    if source.is_dir():
        bundle = sweepid.read_bundle(source)
        return bundle.robot, sweepid.identify(bundle), bundle
    if side_file is None:
        if not source.exists():  # a misspelt name may be that of a bundle
            read_text(source, LARGEST)
        raise BadInput(
            "--robot", "is required with an estimate, which contains neither geometry nor gear ratios of the robot"
        )
    return sweepid.read_robot(side_file), read_document(source, Estimate), None


def read_plan(path: Path) -> PlanDocument:
    """BadInput for a file that `sweepid plan --out` did not write."""
    from pydantic import ValidationError

    from service.model.configuration import bad_field, read_text
    from service.planning.documents import PlanFile

    text = read_text(path)
    try:
        return PlanFile.model_validate_json(text).document
    except ValidationError as error:
        raise bad_field(str(path), error) from None
