"""`sweepid benefit BUNDLE`: what the estimate is worth on sweeps that took no part in it, beside CAD."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from service.benefit import benefit as benefit_of
from service.cli.benefit.table import print_benefit
from service.cli.documents import JsonTo, put_json
from service.cli.progress_indicator import waiting
from service.configuration import read_robot
from service.errors import BadInput
from service.robot import Robot
from service.store.files.bundle import read_bundle


def benefit(
    bundle: Annotated[Path, typer.Argument(help="Directory of the bundle.", show_default=False)],
    robot: Annotated[
        Path | None,
        typer.Option(
            help="CAD model to compare with: side file (YAML) next to its URDF. Default: that of the bundle.",
            metavar="FILE",
        ),
    ] = None,
    json_to: JsonTo = None,
) -> None:
    """Predict the drive torque of held-out sweeps by CAD and by an estimate of the other sweeps."""
    measured = read_bundle(bundle)
    cad = measured.robot if robot is None else _same_joints(read_robot(robot), measured.robot, robot)
    with waiting("estimating"):
        found = benefit_of(cad, measured.sweeps, str(bundle))
    if not found.axes:
        why = "; ".join(f"{joint} {reason}" for joint, reason in found.not_judged.items())
        raise BadInput(str(bundle), f"has no axis that can be evaluated: {why}")
    if not put_json(found, json_to):
        print_benefit(found, Console())


def _same_joints(cad: Robot, measured: Robot, path: Path) -> Robot:
    if cad.joints != measured.joints:
        raise BadInput(
            str(path),
            f"has joints {', '.join(cad.joints)}, but the robot of the bundle has {', '.join(measured.joints)}: "
            "give the robot that was measured",
        )
    return cad
