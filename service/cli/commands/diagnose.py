"""`sweepid diagnose BUNDLE`: where model and measurement disagree, what is missing, and what to measure next."""

from pathlib import Path
from typing import Annotated

import typer

from service.cli.options import Bundle, JsonTo


def diagnose(
    bundle: Bundle,
    axis: Annotated[str | None, typer.Option(help="Diagnose this joint only.")] = None,
    json_to: JsonTo = None,
    known: Annotated[list[str] | None, typer.Option(help="Known effect of the axes; repeatable.")] = None,
    estimate: Annotated[
        Path | None,
        typer.Option(
            help="Start from this estimate (JSON file of `sweepid identify`) instead of the CAD model.", metavar="FILE"
        ),
    ] = None,
    twin: Annotated[
        bool, typer.Option(help="Run the simulator with the model found and print the remaining gap.")
    ] = True,
    model: Annotated[Path | None, typer.Option(help="Write the model with named effects here.", metavar="FILE")] = None,
    scenario: Annotated[
        Path | None,
        typer.Option(help="Write the scenario of the twin to this file, with its robot next to it.", metavar="FILE"),
    ] = None,
    report: Annotated[Path | None, typer.Option(help="Write a page with figures here.", metavar="FILE")] = None,
) -> None:
    """Find where simulation and measurement disagree, and name the missing effect."""
    from rich.console import Console

    from service.cli.documents import as_json, put_json, write_file
    from service.cli.progress_indicator import waiting
    from service.cli.recordings.diagnose import diagnose_bundle, print_diagnosis, write_scenario
    from service.diagnosis import model_document
    from service.results.revision import ModelRevision
    from service.store.files.bundle import read_bundle

    with waiting("diagnosing"):
        measured = read_bundle(bundle)
        found = diagnose_bundle(measured, axis, str(bundle), known or (), estimate, twin=twin)
    if model is not None:
        write_file(model, as_json(ModelRevision.read(model_document(measured.robot, found.as_json()), str(bundle))))
    if scenario is not None:
        write_scenario(scenario, measured.robot, found.model)
    if report is not None:
        from service.report import diagnosis_page

        write_file(report, diagnosis_page(found, f"Diagnosis of the robot {found.model.robot}", str(bundle)).html())
    if put_json(found, json_to):
        return
    print_diagnosis(found, Console())
