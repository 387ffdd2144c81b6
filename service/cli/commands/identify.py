"""`sweepid identify BUNDLE`: the paper's Table 1, the base parameters and their quality from recorded sweeps."""

from pathlib import Path
from typing import Annotated

import typer

import sweepid
from service.cli.options import Bundle, Gains, JsonTo


def identify(
    bundle: Bundle,
    axis: Annotated[str | None, typer.Option(help="Use the sweeps of this joint only.")] = None,
    json_to: JsonTo = None,
    gains: Gains = None,
    model: Annotated[
        Path | None, typer.Option(help="Known effects: JSON file of `sweepid diagnose --model`.", metavar="FILE")
    ] = None,
    report: Annotated[Path | None, typer.Option(help="Write the result with figures to this HTML file.")] = None,
) -> None:
    """Identify a robot from the sweeps of a bundle."""
    from service.cli.documents import put_json, write_file
    from service.cli.progress_indicator import counted, waiting

    with waiting("reading the bundle"):
        measured = sweepid.read_bundle(bundle)
    with waiting("estimating"):
        found = sweepid.identify(measured, axis, torque_gain=gains, effects=model, progress=counted)
    if report is not None:
        from service.cli.recordings.bundle_page import bundle_page

        write_file(report, bundle_page(measured, found, str(bundle)).html())
    if not put_json(found, json_to):
        from service.cli.tables import print_result

        print_result(found)
