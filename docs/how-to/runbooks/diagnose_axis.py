"""Diagnose an axis of a running machine, experiment by experiment; a person says yes before anything moves.

    python diagnose_axis.py max100-class joint_3 --varied joint_2,joint_3 --by "your name"

Measures the sweeps of a diagnosis, tells what they say, offers the next experiment as long as the diagnosis asks for
one, and offers a named effect for the robot's model. Ctrl-C stops the machine. `--yes` answers every question: for
virtual machines alone.
Exit codes: 0 named or nothing missing, 1 left undecided or unknown, 2 the campaign did not come to its end.
"""

import argparse
import sys
from collections.abc import Callable
from typing import Any

from service.client import ServiceClient

Json = dict[str, Any]
SETTLED = ("none", "named")


def main() -> int:
    parser = argparse.ArgumentParser(description="Diagnose an axis.")
    parser.add_argument("robot", help="name of a robot that the service knows")
    parser.add_argument("axis")
    parser.add_argument("--varied", required=True, help="joints that make the poses, comma separated")
    parser.add_argument("--by", required=True, help="who stands at the machine")
    parser.add_argument("--url", default="http://127.0.0.1:8642")
    parser.add_argument("--cell", default="workshop")
    parser.add_argument("--poses", type=int, default=4)
    parser.add_argument("--yes", action="store_true", help="no questions: virtual machines alone")
    given = parser.parse_args()

    def agreed(question: str) -> bool:
        return given.yes or input(f"{question} [y/N] ").strip().lower() == "y"

    with ServiceClient(given.url) as client:
        robot = next((robot for robot in client.robots() if robot["name"] == given.robot), None)
        if robot is None:
            sys.exit(f"{given.url} knows no robot {given.robot}")
        wanted = {"kind": "diagnosis", "robot_id": robot["id"], "cell": given.cell, "axes": [given.axis]}
        plan = client.add_plan(wanted | {"varied": given.varied.split(","), "poses": given.poses})
        document = plan["document"]
        print(f"plan {plan['id']}: {len(document['sweeps'])} sweeps, about {document['duration'] / 60:.0f} min")
        for dropped in document["dropped"]:
            print(f"  left out: {dropped['reason']}")
        if not agreed(f"Is the cell clear? Move {given.axis} now?"):
            return 1
        campaign = int(client.add_campaign(plan["id"])["id"])
        if not completed(client, int(client.start(campaign)["id"])):
            return 2
        diagnosis = client.diagnosed(client.add_diagnosis([campaign], [given.axis])["id"])
        return settled(client, diagnosis, given.axis, given.by, agreed)


def settled(client: ServiceClient, diagnosis: Json, axis: str, by: str, agreed: Callable[[str], bool]) -> int:
    """Tell what was found and go on as long as the diagnosis asks and the person agrees."""
    while True:
        if diagnosis["state"] != "done":
            sys.exit(f"diagnosis {diagnosis['id']} failed: {diagnosis['cause']}")
        found = diagnosis["document"]["axes"][axis]
        print(f"diagnosis {diagnosis['id']}: {found['summary']}")
        wanted = found["next_experiment"]
        if not wanted or not wanted["sweeps"]:
            break
        print(
            f"  next: {wanted['kind']}, {len(wanted['sweeps'])} sweeps, {wanted['seconds']:.0f} s: {wanted['reason']}"
        )
        if wanted["kind"] == "test_mass":
            print("  needs a known mass bolted on: see docs/how-to/diagnose-a-machine.md")
            break
        if not agreed("Is the cell clear? Run it now?"):
            break
        campaign = int(client.approve_experiment(diagnosis["id"], axis, by)["id"])
        if not completed(client, campaign):
            return 2
        diagnosis = continued(client, int(diagnosis["id"]))
    accept = found["verdict"] == "named" and len(found["rolled_back"]) < len(found["effects"])
    if accept and agreed("Take it into the robot's model?"):
        model = client.accept_model(diagnosis["id"], by, [axis])
        print(f"model {model['id']}, revision {model['revision']}")
    return 0 if found["verdict"] in SETTLED else 1


def completed(client: ServiceClient, campaign: int) -> bool:
    """Wait for the campaign's end. A fault pauses it: then somebody must look at the machine, so this ends."""
    try:
        for event in client.events(campaign):
            if event["kind"] == "sweep" and event["data"]["state"] == "identified":
                print(f"  sweep {event['data']['number']} identified")
            state = client.campaign(campaign)
            if state["state"] in ("completed", "paused", "aborted"):
                print(f"campaign {campaign} {state['state']}{': ' if state['cause'] else ''}{state['cause']}")
                return bool(state["state"] == "completed")
    except BaseException as error:
        client.stop("diagnose_axis", type(error).__name__)
        raise
    return False


def continued(client: ServiceClient, parent: int) -> Json:
    """The diagnosis that the service began by itself with the experiment's sweeps, once it is done."""
    for event in client.events():
        if event["kind"] == "diagnosis":
            found = client.diagnosis(event["data"]["diagnosis"])
            if found["parent"] == parent:
                return client.diagnosed(found["id"])
    sys.exit("the service tells no more events")


if __name__ == "__main__":
    sys.exit(main())
