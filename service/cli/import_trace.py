"""`sweepid import-trace MAPPING --out DIR`: a bundle from the trace files of a CNC or a test bench."""

from pathlib import Path
from typing import Annotated

import typer

from service import trace_import
from service.store.bundle import write_bundle


def import_trace(
    mapping: Annotated[Path, typer.Argument(help="Mapping file (YAML).", show_default=False)],
    out: Annotated[Path, typer.Option(help="Directory of the new bundle; must be empty.", show_default=False)],
    source: Annotated[Path | None, typer.Option(help="Trace file in place of the one that the mapping names.")] = None,
) -> None:
    """Turn trace files (.mat, .csv, .parquet) into a bundle."""
    robot, sweeps = trace_import.import_trace(mapping, source)
    write_bundle(out, robot, sweeps)
    typer.echo(f"{out}: {len(sweeps)} sweep{'s' if len(sweeps) > 1 else ''} of {robot.name}", err=True)
