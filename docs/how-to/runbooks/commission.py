"""The first day of a machine: robot file, cell, drives, a first plan of two poses, its campaign, and the results.

    python commission.py robots/my-robot.yaml cells/workshop.yaml --varied joint_2,joint_3 --by "your name"

Each axis is measured in a few poses, to find wrong axes, signs and ratios before a long campaign. Exit codes:
0 every axis has an inertia, 1 failed or the data is wrong, 2 bad input, 3 stopped, 4 the inertia of an axis is not
known or the data has warnings.
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from inertias import inertia_unit
from runbook import Exit, Runbook, optional_list, parser_of, run, worst

from service.data_check import check, findings_document
from service.model import Robot
from service.model.configuration import read_cell, read_robot
from service.store.files.bundle import read_from


def main() -> int:
    parser = parser_of(__doc__)
    parser.add_argument("robot", type=Path, help="side file of the robot (YAML)")
    parser.add_argument("cell", type=Path, help="file of the cell, as the service has it in its cells_dir")
    parser.add_argument("--axes", type=optional_list, default=[], help="comma separated; default: all of the robot")
    parser.add_argument("--varied", type=optional_list, required=True, help="joints that make the poses")
    parser.add_argument("--poses", type=int, default=2)
    parser.add_argument("--step", type=float, default=15.0, help="deg (cm) between the positions of the grid")
    return run("commission", parser, commission)


def commission(book: Runbook) -> Exit:
    given, client = book.given, book.client
    robot = read_robot(given.robot)
    book.step("robot file", f"{robot.name}, {len(robot.joints)} axes: {', '.join(robot.joints)}")
    cell = read_cell(given.cell)
    cell.home_pose(robot.joints)
    book.step("cell", f"{cell.name}, {len(cell.boxes)} boxes, at least {1e3 * cell.clearance:.0f} mm from anything")
    if not ready(book):
        return Exit.FAILED
    stored = client.add_robot(robot.description.model_dump(mode="json"), robot.urdf_text)
    book.identify_machine(client.robot(stored["id"]))
    axes = given.axes or list(robot.joints)
    request = {"robot_id": stored["id"], "cell": given.cell.stem, "axes": axes, "varied": given.varied}
    plan = book.planned(request | {"poses": given.poses, "step": given.step})
    book.step("first plan", "robot file and drives agree, and collision-free paths were found", plan=plan["id"])
    campaign = book.measured(robot, plan)
    if isinstance(campaign, Exit):
        return campaign
    return worst([checked(book, campaign["id"]), *(told(book, robot, campaign["id"], joint) for joint in axes)])


def ready(book: Runbook) -> bool:
    """Checks drives and service; a dry run continues without a machine."""
    drives, causes = book.client.drives(), book.client.ready()["causes"]
    book.step("drives", "connected" if drives["connected"] else f"not connected: {drives['trouble']}")
    for cause in causes:
        book.step("not ready", cause)
    return not causes or book.given.dry_run


def checked(book: Runbook, campaign: int) -> Exit:
    """Checks whether the data is consistent and agrees with the robot file."""
    with TemporaryDirectory() as folder:
        archive = Path(folder) / "campaign.zip"
        book.client.export_bundle(campaign, archive)
        measured = read_from(archive, Path(folder) / "bundle")
    robot, sweeps = measured.robot, measured.sweeps
    found = findings_document(robot, sweeps, check(robot, sweeps)).findings
    return book.findings([one.as_json() for one in found])


def told(book: Runbook, robot: Robot, campaign: int, joint: str) -> Exit:
    """Prints one axis of the first estimate."""
    axis = book.client.estimate(campaign)["document"]["axes"].get(joint)
    if axis is None or not axis["inertia"]:
        book.step(joint, "its sweeps show no inertia", axis=joint)
        return Exit.AMBER
    values = ", ".join(f"{sweep['value']:.4g} +- {sweep['std']:.2g}" for sweep in axis["inertia"])
    book.step(joint, f"{values} {inertia_unit(robot, joint)}", axis=joint, inertia=axis["inertia"])
    return Exit.DONE


if __name__ == "__main__":
    sys.exit(main())
