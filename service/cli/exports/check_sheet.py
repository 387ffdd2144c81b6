"""A later measurement that is compared with a sheet."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import sweepid
from service.model.results.estimate import Estimate
from service.model.results.sheet import AxisCheck, SheetCheck
from service.model.robot import Robot, RobotDescription, build_robot
from service.web.client import ServiceClient

Poses = dict[str, NDArray[np.float64]]


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


def of_bundle(place: Path) -> tuple[Robot, Estimate, Poses]:
    """Robot, estimate and the poses of each axis."""
    measured = sweepid.read_bundle(place)
    specs = {sweep.spec.id: sweep.spec.pose for sweep in measured.sweeps}
    estimate = sweepid.identify(measured)
    return measured.robot, estimate, _poses(estimate, specs)


def of_campaign(number: int, url: str) -> tuple[Robot, Estimate, Poses]:
    """The same of a campaign of the service."""
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
