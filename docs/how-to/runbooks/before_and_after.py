"""Has a repair changed the robot? Compares two campaigns of one plan, before and after the repair, for each axis.

    python before_and_after.py max100-class --axes joint_2,joint_3 --varied joint_3 --by "your name"
    python before_and_after.py max100-class --before 7 --by "your name"
    python before_and_after.py max100-class --before 7 --after 9 --by "your name"

The first command measures before the repair, the second one measures the same plan after it, the third one moves
nothing. Printed for each axis: its inertia over the common poses of both campaigns (without one, over all), before and
after, the difference, its standard deviation and significance. Exit codes: 0 no axis changed (or: before is measured),
1 an axis changed by more than 4 standard deviations, or failed, 2 bad input, 3 stopped, 4 an axis between 2 and 4.
"""

import sys

import numpy as np
from inertias import inertia_unit, inertias
from numpy.typing import NDArray
from runbook import CELL_HELP, Exit, Runbook, judged, optional_list, parser_of, run, worst

from service import BadInput
from service.formats.export.sheets.inertias import Inertias
from service.model import Robot
from service.web.client import Json


def main() -> int:
    parser = parser_of(__doc__)
    parser.add_argument("robot", help="name of a robot that is stored in the service")
    parser.add_argument("--before", type=int, help="campaign before the repair; default: measure it")
    parser.add_argument("--after", type=int, help="campaign after the repair; default: measure it")
    parser.add_argument("--axes", type=optional_list, default=[], help="before: joints to measure, comma separated")
    parser.add_argument("--varied", type=optional_list, default=[], help="before: joints that make the poses")
    parser.add_argument("--cell", help=CELL_HELP)
    parser.add_argument("--step", type=float, default=5.0, help="before: deg (cm) between the positions of the grid")
    parser.add_argument("--poses", type=int, default=8, help="before: how many")
    return run("before_and_after", parser, before_and_after)


def before_and_after(book: Runbook) -> Exit:
    given, client = book.given, book.client
    if given.before is None:
        return first(book)
    before = book.completed(given.before)
    robot = book.identify_machine(client.robot(before["robot_id"]))
    after = book.repeated(robot, before)
    return after if isinstance(after, Exit) else compared(book, robot, before, after)


def first(book: Runbook) -> Exit:
    """Measure the campaign before the repair."""
    given = book.given
    if given.after is not None or not given.axes or not given.varied:
        raise BadInput("before", "give --before with the number of a campaign, or --axes and --varied to measure one")
    document = book.robot_named(given.robot)
    robot = book.identify_machine(document)
    request = {"robot_id": document["id"], "cell": book.cell(), "axes": given.axes, "varied": given.varied}
    campaign = book.measured(robot, book.planned(request | {"step": given.step, "poses": given.poses}))
    if isinstance(campaign, Exit):
        return campaign
    book.step("after the repair", f"before_and_after.py {given.robot} --before {campaign['id']}")
    return Exit.DONE


def compared(book: Runbook, robot: Robot, before: Json, after: Json) -> Exit:
    """Print each axis' inertia, the mean over the common poses, and the verdict."""
    if before["robot_id"] != after["robot_id"]:
        raise BadInput("after", f"campaign {after['id']} is of another revision of the robot than {before['id']}")
    estimates = [book.client.estimate(campaign["id"])["document"] for campaign in (before, after)]
    poses = compared_at([book.client.sweeps(campaign["id"]) for campaign in (before, after)])
    if not len(poses):
        raise BadInput("after", f"campaigns {before['id']} and {after['id']} have no identified sweep: resume them")
    axes = [joint for joint in estimates[0]["axes"] if joint in estimates[1]["axes"]]
    codes: list[Exit] = []
    words: list[str] = []
    for joint in axes:
        means, variances = np.array(
            [
                (values.mean(), covariance.mean())  # mean over the poses
                for campaign, estimate in zip((before, after), estimates, strict=True)
                for values, covariance in [known(robot, campaign, estimate, joint, poses, before)]
            ]
        ).T.tolist()
        difference, std = means[1] - means[0], float(np.sqrt(sum(variances)))
        significance, percent = difference / std, 100 * difference / means[0]
        codes.append(judged(significance))
        changed = {Exit.DONE: "unchanged", Exit.AMBER: "perhaps changed"}.get(codes[-1], "changed")
        words.append(f"{joint} {changed} ({percent:+.2f} %, {significance:+.1f} standard deviations)")
        book.step(
            joint,
            f"{means[0]:.4g} before, {means[1]:.4g} after: {difference:+.3g} +- {std:.2g} {inertia_unit(robot, joint)} "
            f"over {len(poses)} poses, {significance:+.1f} standard deviations",
            axis=joint,
            before=means[0],
            after=means[1],
            difference=difference,
            std=std,
            significance=significance,
            poses=len(poses),
        )
    if not axes:
        raise BadInput("after", "the campaigns have no axis in common")
    book.step("verdict", f"From campaign {before['id']} to {after['id']}: {', '.join(words)}.")
    return worst(codes)


def known(
    robot: Robot, campaign: Json, estimate: Json, joint: str, poses: NDArray[np.float64], before: Json
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Inertia (m,) at poses (m, n) with covariance (m, m); BadInput for a campaign of too few poses says what to do."""
    try:
        return inertias(robot, estimate, joint, poses, f"campaign {campaign['id']}")
    except BadInput as error:
        after = f"measure the plan of campaign {before['id']} again: --before {before['id']} without --after"
        raise BadInput("after" if campaign is not before else "before", f"{error}. Too few poses: {after}") from None


def compared_at(sweeps: list[list[Json]]) -> NDArray[np.float64]:
    """The poses (m, n) that both lists identified; without one, those of either: base parameters give J there."""
    poses = [[sweep["spec"]["pose"] for sweep in each if sweep["state"] == "identified"] for each in sweeps]
    if not all(poses):
        return np.empty((0, 0))
    first, second = (np.unique(each, axis=0) for each in poses)
    both = first[np.abs(first[:, None] - second[None]).max(axis=2).min(axis=1) < Inertias.still]
    return both if len(both) else np.concatenate([first, second])


if __name__ == "__main__":
    sys.exit(main())
