"""`sweepid export-recording BUNDLE OUT`: recordings for the tools of others."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from service.cli.progress_indicator import waiting
from service.errors import BadInput
from service.export.recordings import write_recordings
from service.store.files.bundle import read_bundle


def export_recording(
    bundle: Annotated[Path, typer.Argument(help="Directory of the bundle.", show_default=False)],
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
