"""`sweepid check-sheet SHEET`: is the robot still the one of the sheet?"""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray

from service.cli.address import DEFAULT_URL, Url
from service.cli.documents import JsonTo, put_json, read_document
from service.cli.progress_indicator import waiting
from service.cli.recordings.identify import identify_bundle
from service.client import ServiceClient
from service.errors import BadInput
from service.export.sheets.same_robot import compare
from service.results.estimate import Estimate
from service.results.identified.sheet import Sheet
from service.results.identified.sheet_check import AxisCheck, SheetCheck
from service.robot import Robot, RobotDescription, build_robot
from service.store.files.bundle import read_bundle

Poses = dict[str, NDArray[np.float64]]
DIFFERENT = 1


def check_sheet(
    sheet: Annotated[
        Path, typer.Argument(help="JSON file of `sweepid export-sheet --json`.", metavar="SHEET", show_default=False)
    ],
    bundle: Annotated[Path | None, typer.Argument(help="Bundle that was measured later.", metavar="[BUNDLE]")] = None,
    campaign: Annotated[
        int | None, typer.Option(help="Number of a campaign that was measured later.", metavar="N", min=1)
    ] = None,
    url: Url = DEFAULT_URL,
    json_to: JsonTo = None,
) -> None:
    """Compare a later measurement with a sheet, axis by axis, with significance. Exit code 1: the robot differs."""
    stored = read_document(sheet, Sheet)
    if (bundle is None) == (campaign is None):
        raise BadInput("BUNDLE", "name either a bundle or a campaign (--campaign N) that was measured later")
    with waiting("the comparison"):
        if bundle is not None:
            robot, estimate, poses = _of_bundle(bundle)
        else:
            robot, estimate, poses = _of_campaign(campaign or 0, url)
        found = compare(stored, robot, estimate, poses, str(bundle or f"campaign {campaign}"))
    if not put_json(found, json_to):
        typer.echo(as_text(found))
    if found.verdict != "the same":
        raise typer.Exit(DIFFERENT)


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


def _of_bundle(place: Path) -> tuple[Robot, Estimate, Poses]:
    measured = read_bundle(place)
    specs = {sweep.spec.id: sweep.spec.pose for sweep in measured.sweeps}
    estimate = identify_bundle(measured, None, str(place))
    return measured.robot, estimate, _poses(estimate, specs)


def _of_campaign(number: int, url: str) -> tuple[Robot, Estimate, Poses]:
    with ServiceClient(url) as client:
        stored = client.robot(client.campaign(number)["robot_id"])
        estimate = Estimate.read(client.estimate(number)["document"], f"campaign {number}")
        specs = {sweep["spec"]["id"]: tuple(sweep["spec"]["pose"]) for sweep in client.sweeps(number)}
    robot = build_robot(RobotDescription.model_validate(stored["description"]), stored["urdf_text"])
    return robot, estimate, _poses(estimate, specs)


def _poses(estimate: Estimate, specs: dict[str, tuple[float, ...]]) -> Poses:
    """Of the sweeps that each axis was identified by."""
    return {
        joint: np.array([specs[sweep.sweep] for sweep in axis.inertia if sweep.sweep in specs])
        for joint, axis in estimate.axes.items()
    }
