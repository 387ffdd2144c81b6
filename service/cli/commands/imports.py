"""`sweepid import`: bundles into the service, traces of a CNC or a test bench to bundles."""

import sys
import tempfile
import zipfile
from pathlib import Path
from typing import Annotated

import typer

import sweepid
from service.cli.options import DEFAULT_URL, Url
from service.errors import BadInput


def import_bundle(
    bundle: Annotated[Path, typer.Argument(help="Folder of a bundle, or a zip of it.")],
    url: Url = DEFAULT_URL,
) -> None:
    """Bring measured sweeps into the service, which identifies them. Prints the number of the campaign.

    What a check of the data finds goes to stderr.
    """
    import asyncio

    from service.cli.campaign.import_check import findings_of
    from service.cli.progress_indicator import waiting
    from service.client import ServiceClient
    from service.store.files.isolated_reader import read_isolated

    with ServiceClient(url) as client, tempfile.TemporaryDirectory() as folder:
        archive = _pack(bundle, Path(folder) / "bundle.zip") if bundle.is_dir() else bundle
        if not zipfile.is_zipfile(archive):
            raise BadInput(str(bundle), "is neither the folder of a bundle nor a zip file")
        with waiting("the service reads the bundle"):
            campaign = client.import_bundle(archive)
        sys.stdout.write(f"{campaign['id']}\n")
        try:
            lines: list[str] = asyncio.run(read_isolated(findings_of, (bundle, Path(folder) / "bundle"), str(bundle)))
        except BadInput as error:  # it is imported all the same, and the service checks it too
            lines = [f"not checked: {error}"]
        for line in lines:
            typer.echo(line, err=True)


def _pack(folder: Path, target: Path) -> Path:
    if not (folder / "bundle.json").is_file():
        raise BadInput(str(folder / "bundle.json"), "does not exist")
    with zipfile.ZipFile(target, "w", zipfile.ZIP_STORED) as archive:  # Parquet is compressed already
        for path in sorted(folder.rglob("*")):
            archive.write(path, path.relative_to(folder))
    return target


def import_trace(
    mapping: Annotated[
        Path, typer.Argument(help="Mapping file (YAML), or a Sinumerik's measurement (XML).", show_default=False)
    ],
    out: Annotated[
        Path | None, typer.Option(help="Directory of the new bundle, or of a measurement's tables; must be empty.")
    ] = None,
    source: Annotated[Path | None, typer.Option(help="Trace file in place of the one that the mapping names.")] = None,
    speed_gain: Annotated[
        float | None, typer.Option(min=1e-12, help="XML: gain of the speed controller, p1460, N m s/rad.")
    ] = None,
    reset_time: Annotated[
        float | None,
        typer.Option(min=1e-6, help="XML: reset time of an integral part without reference model, p1462, s."),
    ] = None,
    gear_ratio: Annotated[
        float | None, typer.Option(min=1e-9, help="XML: motor rad per joint rad (m), in place of the file's.")
    ] = None,
    json_to: Annotated[
        str | None, typer.Option("--json", help="XML: write JSON here; - is stdout.", metavar="FILE")
    ] = None,
) -> None:
    """Turn trace files (.mat, .csv, .parquet) into a bundle, or read what a Sinumerik measured of itself (.xml)."""
    if mapping.suffix.lower() == ".xml":
        if source is not None:
            raise BadInput("--source", f"{mapping} is the measurement itself, not a mapping")
        from service.cli.recordings.control_file import import_control_file
        from service.sinumerik.document import Given

        import_control_file(mapping, Given(speed_gain, reset_time, gear_ratio), out, json_to)
        return
    options = {
        "--speed-gain": speed_gain,
        "--reset-time": reset_time,
        "--gear-ratio": gear_ratio,
        "--json": json_to,
    }
    for name, value in options.items():
        if value is not None:
            raise BadInput(name, f"applies only to a measurement of a Sinumerik (.xml); {mapping} is a mapping")
    if out is None:
        raise BadInput("--out", "is missing: give the directory of the new bundle")
    from service.cli.progress_indicator import waiting
    from service.cli.recordings.check import warn
    from service.data_check import check

    with waiting("reading the traces"):
        made = sweepid.import_trace(mapping, source, out)
    warn(check(made.robot, made.sweeps))
    count = len(made.sweeps)
    typer.echo(f"{out}: {count} sweep{'s' if count > 1 else ''} of {made.robot.name}", err=True)
