"""`sweepid diagnose BUNDLE`: where model and measurement disagree, what is missing, and what to measure next."""

from pathlib import Path
from typing import Annotated

import typer

import sweepid
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
    from service.cli.documents import put_json, write_file
    from service.cli.progress_indicator import counted, waiting

    with waiting("diagnosing"):
        measured = sweepid.read_bundle(bundle)
        found = sweepid.diagnose(measured, axis, known=known or (), start=estimate, twin=twin, progress=counted)
    if model is not None:
        from service.diagnosis import model_document
        from service.model.results.effect import ModelRevision

        revision = ModelRevision.read(model_document(measured.robot, found.as_json()), str(bundle))
        write_file(model, revision.to_json())
    if scenario is not None:
        from service.cli.recordings.scenario_file import write_scenario

        write_scenario(scenario, measured.robot, found.model)
    if report is not None:
        from service.report import diagnosis_page

        write_file(report, diagnosis_page(found, f"Diagnosis of the robot {found.model.robot}", str(bundle)).html())
    if not put_json(found, json_to):
        from service.cli.tables import print_result

        print_result(found)
