"""`sweepid identify BUNDLE`: the paper's Table 1, the base parameters and their quality from recorded sweeps."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import sweepid
from service import BadInput
from service.cli.terminal import (
    DEFAULT_URL,
    BundleArg,
    Gains,
    JsonTo,
    Url,
    connect,
    counted,
    put_json,
    show,
    waiting,
    write_file,
)

if TYPE_CHECKING:
    from service.model import Array, Robot
    from service.model.results.diagnosis import DiagnosedModel
    from service.model.results.estimate import Estimate
    from service.model.results.sheet import AxisCheck, SheetCheck


def identify(
    bundle: BundleArg,
    axis: Annotated[str | None, typer.Option(help="Use the sweeps of this joint only.")] = None,
    json_to: JsonTo = None,
    gains: Gains = None,
    model: Annotated[
        Path | None, typer.Option(help="Known effects: JSON file of `sweepid diagnose --model`.", metavar="FILE")
    ] = None,
    report: Annotated[Path | None, typer.Option(help="Write the result with figures to this HTML file.")] = None,
    prior_from: Annotated[
        list[Path] | None,
        typer.Option(
            help="Estimate of another robot of the type (JSON file); four or more are a prior.", metavar="FILE"
        ),
    ] = None,
) -> None:
    """Identify a robot from the sweeps of a bundle."""

    with waiting("reading the bundle"):
        measured = sweepid.read_bundle(bundle)
    with waiting("estimating"):
        found = sweepid.identify(
            measured, axis, torque_gain=gains, effects=model, prior_from=prior_from or (), progress=counted
        )
    if report is not None:
        from service.cli.report_pages import bundle_page

        write_file(report, bundle_page(measured, found, str(bundle)).html())
    show(found, json_to)


def diagnose(
    bundle: BundleArg,
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

    with waiting("diagnosing"):
        measured = sweepid.read_bundle(bundle)
        found = sweepid.diagnose(measured, axis, known=known or (), start=estimate, twin=twin, progress=counted)
    if model is not None:
        from service.diagnosis import model_document

        write_file(model, model_document(measured.robot, found).to_json())
    if scenario is not None:
        write_scenario(scenario, measured.robot, found.model)
    if report is not None:
        from service.report.diagnosis import diagnosis_page

        write_file(report, diagnosis_page(found, f"Diagnosis of the robot {found.model.robot}", str(bundle)).html())
    show(found, json_to)


def write_scenario(path: Path, robot: Robot, model: DiagnosedModel) -> None:
    """The model's scenario, which the virtual machine can load: with the robot's description and URDF beside it."""
    import yaml

    description = robot.description.model_dump(mode="json") | {"urdf": f"{path.stem}-robot.urdf"}
    files = {
        description["urdf"]: robot.urdf_text,
        f"{path.stem}-robot.yaml": yaml.safe_dump(description, sort_keys=False),
        path.name: yaml.safe_dump({**model.scenario, "robot": f"{path.stem}-robot.yaml"}, sort_keys=False),
    }
    for name, text in files.items():
        write_file(path.parent / name, text)


def check(bundle: BundleArg, json_to: JsonTo = None) -> None:
    """Tell what is wrong with recordings and robot file, before any physics."""

    with waiting("checking the data"):
        found = sweepid.check(bundle)
    show(found, json_to)


def check_sheet(
    sheet: Annotated[
        Path, typer.Argument(help="JSON file of `sweepid export sheet --json`.", metavar="SHEET", show_default=False)
    ],
    bundle: Annotated[Path | None, typer.Argument(help="Bundle that was measured later.", metavar="[BUNDLE]")] = None,
    campaign: Annotated[
        int | None, typer.Option(help="Number of a campaign that was measured later.", metavar="N", min=1)
    ] = None,
    url: Url = DEFAULT_URL,
    json_to: JsonTo = None,
) -> None:
    """Compare a later measurement with a sheet, axis by axis, with significance. Exit code 1: the robot differs."""
    from service.formats.export.sheets.making import compare
    from service.model.results.sheet import Sheet
    from sweepid.files import read_document

    stored = read_document(sheet, Sheet)
    if (bundle is None) == (campaign is None):
        raise BadInput("BUNDLE", "name either a bundle or a campaign (--campaign N) that was measured later")
    with waiting("the comparison"):
        if bundle is not None:
            robot, estimate, poses = of_bundle(bundle)
        else:
            robot, estimate, poses = of_campaign(campaign or 0, url)
        found = compare(stored, robot, estimate, poses, str(bundle or f"campaign {campaign}"))
    if not put_json(found, json_to):
        typer.echo(as_text(found))
    if found.verdict != "the same":
        raise typer.Exit(1)


def as_text(found: SheetCheck) -> str:
    """The verdict first, then a line an axis."""
    head = f"{found.robot}: {found.verdict} as the sheet {found.fingerprint}"
    if found.verdict != "the same":
        head = f"{found.robot}: {found.verdict} since the sheet {found.fingerprint}"
    lines = [f"{head} (probability of such a difference by chance: {found.probability:.2g})"]
    lines += [_line(axis) for axis in found.axes]
    lines += [f"{joint}: not compared, {found.source} did not measure it" for joint in found.not_compared]
    return "\n".join(lines)


def _line(axis: AxisCheck) -> str:
    return (
        f"{axis.joint}: {axis.now:.4g} now, {axis.sheet:.4g} by the sheet, {axis.differs_percent:+.2f} %, "
        f"{axis.differs_in_std:+.1f} standard deviations (mean of {axis.poses} poses)"
    )


def of_bundle(place: Path) -> tuple[Robot, Estimate, dict[str, Array]]:
    """Robot, estimate and the poses of each axis."""
    measured = sweepid.read_bundle(place)
    specs = {sweep.spec.id: sweep.spec.pose for sweep in measured.sweeps}
    estimate = sweepid.identify(measured)
    return measured.robot, estimate, _poses(estimate, specs)


def of_campaign(number: int, url: str) -> tuple[Robot, Estimate, dict[str, Array]]:
    """The same of a campaign of the service."""
    from service.model import RobotDescription, build_robot
    from service.model.results.estimate import Estimate

    with connect(url) as client:
        stored = client.robot(client.campaign(number)["robot_id"])
        estimate = Estimate.read(client.estimate(number)["document"], f"campaign {number}")
        specs = {sweep["spec"]["id"]: tuple(sweep["spec"]["pose"]) for sweep in client.sweeps(number)}
    robot = build_robot(RobotDescription.model_validate(stored["description"]), stored["urdf_text"])
    return robot, estimate, _poses(estimate, specs)


def _poses(estimate: Estimate, specs: dict[str, tuple[float, ...]]) -> dict[str, Array]:
    """Of the sweeps that each axis was identified by."""
    import numpy as np

    return {
        joint: np.array([specs[sweep.sweep] for sweep in axis.inertia if sweep.sweep in specs])
        for joint, axis in estimate.axes.items()
    }
