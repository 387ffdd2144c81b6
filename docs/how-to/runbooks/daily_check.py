"""Has the machine changed? One sweep of each axis in one or two poses is compared with the robot's stored estimate.

    python daily_check.py max100-class --by "your name"

For each axis: green up to 2 standard deviations, amber up to 4, red above. The standard deviation includes estimate
and sweep. Exit codes: 0 all green, 1 an axis red or the check failed, 2 bad input, 3 stopped, 4 an axis amber.
"""

import sys

import numpy as np
from inertias import inertia_unit, inertias
from runbook import Exit, Runbook, judged, optional_list, parser_of, request_of, run, worst

from service import BadInput
from service.model import Robot
from service.web.client import Json, ServiceProblem

LEAST_POSES = 3  # per axis; a campaign with fewer poses is itself a check and no reference
NAMED = 3  # campaigns in an error: the newest
COLOUR = {Exit.DONE: "green", Exit.AMBER: "amber", Exit.FAILED: "red"}


def main() -> int:
    parser = parser_of(__doc__)
    parser.add_argument("robot", help="name of a robot that is stored in the service")
    parser.add_argument("--axes", type=optional_list, default=[], help="comma separated; default: all of the estimate")
    parser.add_argument("--poses", type=int, choices=(1, 2), default=1)
    parser.add_argument(
        "--campaign", type=int, help="campaign of the reference estimate; default: the newest that is suitable"
    )
    return run("daily_check", parser, check)


def check(book: Runbook) -> Exit:
    reference, estimate = stored(book)
    plan = book.client.plan(reference["plan_id"])
    robot = book.identify_machine(book.client.robot(reference["robot_id"]))
    axes = book.given.axes or list(estimate["axes"])
    book.step("reference", f"campaign {reference['id']} of {reference['created_at'][:10]}", campaign=reference["id"])
    once = {"axes": axes, "poses": book.given.poses, "realisations": 1, "warm_up": 0.0}
    campaign = book.measured(robot, book.planned(request_of(plan) | once))
    if isinstance(campaign, Exit):
        return campaign
    codes = {joint: compared(book, robot, estimate, campaign, joint) for joint in axes}
    for joint in (joint for joint, code in codes.items() if code is Exit.FAILED):
        varied = ",".join(plan["document"]["request"]["varied"])
        command = f"diagnose_axis.py {book.given.robot} {joint} --varied {varied}"
        book.step("next", f"if no load was changed, {command}", axis=joint)
    return worst(list(codes.values()))


def stored(book: Runbook) -> tuple[Json, Json]:
    """The reference campaign, and the document of its latest estimate."""
    given, client = book.given, book.client
    ids = {robot["id"] for robot in client.robots() if robot["name"] == given.robot}
    if not ids:
        raise BadInput("robot", f"{given.url} has no robot {given.robot}")
    wanted = None if given.campaign is None else client.campaign(given.campaign)
    lacks: list[str] = []
    for campaign in [wanted] if wanted else reversed(client.campaigns()):
        if campaign["state"] != "completed" or campaign["robot_id"] not in ids or campaign["plan_id"] is None:
            continue
        try:
            estimate = client.estimate(campaign["id"])["document"]
        except ServiceProblem:
            continue  # measured, but not identified
        if "kind" in client.plan(campaign["plan_id"])["document"]["request"]:
            continue
        lack = lacking(estimate, given.axes)
        if not lack:
            return campaign, estimate
        lacks.append(f"campaign {campaign['id']}: {lack}")
    told = "; ".join(lacks[:NAMED]) or "no campaign that could be one is completed"
    raise BadInput("campaign", f"no reference to compare with: {told}. Measure a campaign with more poses first")


def lacking(estimate: Json, wanted: list[str]) -> str:
    """What an estimate lacks to be the reference; empty: nothing."""
    axes = {joint: estimate["axes"].get(joint) for joint in wanted or estimate["axes"]}
    few = [joint for joint, axis in axes.items() if axis is None or len(axis["inertia"]) < LEAST_POSES]
    if few or not axes:
        return f"{', '.join(few) or 'no axis'} measured in fewer than {LEAST_POSES} poses"
    left_open = [joint for joint, axis in axes.items() if axis is not None and axis["confidence_percent"] is None]
    if left_open:
        return f"J of {', '.join(left_open)} is left open, the sweeps determine a base parameter no better than CAD"
    return ""


def compared(book: Runbook, robot: Robot, estimate: Json, campaign: Json, joint: str) -> Exit:
    """Print the axis' sweeps compared with the estimate; the worst one counts."""
    poses = {sweep["spec"]["id"]: sweep["spec"]["pose"] for sweep in book.client.sweeps(campaign["id"])}
    found = book.client.estimate(campaign["id"])["document"]["axes"].get(joint)
    if found is None:
        book.step(joint, "red: its sweep shows no inertia", colour="red")
        return Exit.FAILED
    codes: list[Exit] = []
    for sweep in found["inertia"]:
        (expected,), ((variance,),) = inertias(
            robot, estimate, joint, np.array([poses[sweep["sweep"]]]), "the stored estimate"
        )
        std = float(np.hypot(np.sqrt(variance), sweep["std"]))
        deviation, significance = 100 * (sweep["value"] / expected - 1), (sweep["value"] - expected) / std
        codes.append(judged(significance))
        colour = COLOUR[codes[-1]]
        book.step(
            joint,
            f"{colour}: {deviation:+.2f} % from the estimate, {significance:+.1f} standard deviations "
            f"({sweep['value']:.4g}, expected {expected:.4g} {inertia_unit(robot, joint)})",
            axis=joint,
            colour=colour,
            deviation_percent=deviation,
            significance=significance,
            measured={"value": sweep["value"], "std": sweep["std"]},
            estimate={"value": float(expected), "std": float(np.sqrt(variance))},
        )
    return worst(codes)


if __name__ == "__main__":
    sys.exit(main())
