"""`sweepid identify BUNDLE`: the paper's Table 1, the base parameters and their quality from recorded sweeps."""

from pathlib import Path
from typing import Annotated

import typer

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
    from rich.console import Console

    from service.cli.documents import put_json, write_file
    from service.cli.progress_indicator import waiting
    from service.cli.recordings.gains_file import read_gains
    from service.cli.recordings.identify import identify_bundle, print_estimate, read_effects
    from service.store.files.bundle import read_bundle

    with waiting("reading the bundle"):
        measured = read_bundle(bundle)
    found = identify_bundle(
        measured,
        axis,
        str(bundle),
        read_gains(gains) if gains else None,
        read_effects(model, measured.robot) if model else None,
    )
    if report is not None:
        from service.cli.recordings.bundle_page import bundle_page

        write_file(report, bundle_page(measured, found, str(bundle)).html())
    if put_json(found, json_to):
        return
    print_estimate(found, Console())
