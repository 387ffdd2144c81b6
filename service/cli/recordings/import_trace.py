"""`sweepid import-trace`: a bundle from the traces of a CNC or a test bench; a Sinumerik's own measurement as it is."""

from pathlib import Path
from typing import Annotated

import typer

from service.cli.progress_indicator import waiting
from service.cli.recordings.check import warn
from service.cli.recordings.control_file import import_control_file
from service.data_check import check
from service.errors import BadInput
from service.sinumerik.document import Given
from service.store.files.bundle import write_bundle
from service.traces import trace_import


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
    with waiting("reading the traces"):
        robot, sweeps = trace_import.import_trace(mapping, source)
    write_bundle(out, robot, sweeps)
    warn(check(robot, sweeps))
    typer.echo(f"{out}: {len(sweeps)} sweep{'s' if len(sweeps) > 1 else ''} of {robot.name}", err=True)
