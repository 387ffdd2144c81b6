"""Diagnose a deviation: find the cause why an axis differs from its model, experiment by experiment.

    python diagnose_axis.py max100-class joint_3 --varied joint_2,joint_3 --by "your name"
    python diagnose_axis.py max100-class joint_3 --campaigns 4,5 --by "your name"

The first command measures the sweeps of a diagnosis; the second one uses completed campaigns, and moves nothing before
the first experiment. Both report what the sweeps show, offer the next experiment as long as one is proposed,
and offer to accept named effects into the model of the robot. Exit codes: 0 the effect is named or nothing is missing,
1 a campaign or the diagnosis failed or the data is wrong, 2 bad input, 3 stopped or declined, 4 not decided.
"""

import sys

from runbook import CELL_HELP, Exit, Runbook, minutes, optional_list, parser_of, run, worst

from service import BadInput
from service.model import Robot
from service.web.client import Json

SETTLED = ("none", "named")


def main() -> int:
    parser = parser_of(__doc__)
    parser.add_argument("robot", help="name of a robot that is stored in the service")
    parser.add_argument("axis", help="the joint that deviates")
    parser.add_argument("--varied", type=optional_list, default=[], help="joints that make the poses, comma separated")
    parser.add_argument("--campaigns", type=optional_list, default=[], help="completed campaigns to diagnose instead")
    parser.add_argument("--cell", help=CELL_HELP)
    parser.add_argument("--poses", type=int, default=4)
    return run("diagnose_axis", parser, diagnose)


def diagnose(book: Runbook) -> Exit:
    given, client = book.given, book.client
    document = book.robot_named(given.robot)
    robot = book.identify_machine(document)
    if given.axis not in robot.joints:
        raise BadInput("axis", f"robot {given.robot} has no joint {given.axis}; it has: {', '.join(robot.joints)}")
    if bool(given.campaigns) == bool(given.varied):
        raise BadInput("--varied", "give either --varied to measure, or --campaigns to use completed campaigns")
    if given.campaigns:
        campaigns = completed(book, document["id"])
        if given.dry_run:
            book.step("diagnosis", f"campaigns {', '.join(given.campaigns)} would be diagnosed; moves nothing")
            return Exit.DONE
    else:
        wanted = {"kind": "diagnosis", "robot_id": document["id"], "cell": book.cell(), "axes": [given.axis]}
        plan = book.planned(wanted | {"varied": given.varied, "poses": given.poses})
        campaign = book.measured(robot, plan)
        if isinstance(campaign, Exit):
            return campaign
        campaigns = [int(campaign["id"])]
    return settled(book, robot, int(client.add_diagnosis(campaigns, [given.axis])["id"]))


def completed(book: Runbook, robot_id: int) -> list[int]:
    """The numbers of --campaigns. BadInput for one of another robot, or one that is not completed."""
    for text in book.given.campaigns:
        if not text.isdecimal():
            raise BadInput("--campaigns", f"{text} is not the number of a campaign")
        campaign = book.client.campaign(int(text))
        if campaign["robot_id"] != robot_id or campaign["state"] != "completed":
            state = f"campaign {text} of robot {campaign['robot_id']} is {campaign['state']}"
            raise BadInput("--campaigns", f"{state}; it must be completed, and of robot {robot_id}")
    return [int(text) for text in book.given.campaigns]


def settled(book: Runbook, robot: Robot, number: int) -> Exit:
    """Report a diagnosis; continue while it proposes an experiment and the person agrees."""
    client, axis = book.client, book.given.axis
    while True:
        book.step("waiting", f"the service computes diagnosis {number}; it takes minutes, and nothing moves")
        diagnosis = client.diagnosed(number)
        if diagnosis["state"] != "done":
            book.step(f"diagnosis {number}", f"failed: {diagnosis['cause']}", diagnosis=number)
            return Exit.FAILED
        found: Json = diagnosis["document"]["axes"][axis]
        wrong = book.findings(found["data"])
        book.step(f"diagnosis {number}", found["summary"], diagnosis=number, verdict=found["verdict"])
        experiment = found["next_experiment"]
        if not experiment or not experiment["sweeps"] or wrong is Exit.FAILED:
            break
        code = measured(book, robot, number, experiment)
        if code is not None:
            return code
        number = continued(book, number)
    if found["verdict"] in SETTLED:
        return worst([wrong, accepted(book, number, found)])
    return worst([wrong, Exit.AMBER])


def measured(book: Runbook, robot: Robot, number: int, experiment: Json) -> Exit | None:
    """Run the experiment that a diagnosis proposes; None when it is completed."""
    client, axis = book.client, book.given.axis
    size = f"{len(experiment['sweeps'])} sweeps, {minutes(experiment['seconds'])}"
    book.step("next experiment", f"{experiment['kind']}, {size}: {experiment['reason']}")
    if experiment["kind"] == "test_mass":
        book.step("test mass", "mount a known mass and approve it: docs/how-to/diagnose-a-machine.md")
        return Exit.AMBER
    plan = client.plan_experiment(number, axis, book.given.cell, **book.typed)
    book.tell_moves(robot, plan["document"]["sweeps"])
    if not book.agreed("Is the cell clear, may the machine move?", "yes"):
        book.step("next experiment", "declined")
        return Exit.STOPPED
    book.moving = True
    campaign = client.approve_experiment(number, axis, book.given.by, cell=book.given.cell, **book.typed)
    if campaign["state"] == "planned":
        book.moving = False
        book.step(f"campaign {campaign['id']}", "needs the approval of its plan and a start by a person; "
                  "then run this again with --campaigns")  # fmt: skip
        return Exit.AMBER
    book.protocol["campaign"] = campaign["id"]
    campaign = book.followed(campaign["id"], {sweep["number"]: 0 for sweep in client.sweeps(campaign["id"])})
    return None if campaign["state"] == "completed" else book.not_completed(campaign)


def continued(book: Runbook, parent: int) -> int:
    """The diagnosis that the service starts automatically with the sweeps of the experiment."""
    for event in book.client.events():
        if event["kind"] == "diagnosis" and event["data"]["diagnosis"] > parent:
            found = book.client.diagnosis(event["data"]["diagnosis"])
            if found["parent"] == parent:
                return int(found["id"])
    raise BadInput(
        "diagnosis",
        f"the service ended the connection before it continued diagnosis {parent}: run this again with --campaigns",
    )


def accepted(book: Runbook, number: int, found: Json) -> Exit:
    """Offer the named effects that were not rolled back for acceptance into the robot's model."""
    if found["verdict"] == "named" and len(found["rolled_back"]) < len(found["effects"]):
        if book.agreed("Accept the named effects into the model of the robot?", "accept"):
            model = book.client.accept_model(number, book.given.by, [book.given.axis])
            book.step("model", f"{model['id']}, revision {model['revision']}", model=model["id"])
        else:
            book.step("model", "unchanged")
    return Exit.DONE


if __name__ == "__main__":
    sys.exit(main())
