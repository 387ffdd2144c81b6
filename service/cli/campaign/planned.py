"""Robot, cell and machine of a plan, for the commands that plan."""

import sys
from pathlib import Path

from service.model.configuration import read_robot
from service.model.errors import BadInput
from service.planning.campaigns.stored_plan import plan_subject
from service.web.client import Json, ServiceClient


def robot_number(client: ServiceClient, side_file: Path | None) -> int:
    """The service's number of the robot of a side file, or of its machine. BadInput if that is not configured."""
    if side_file is not None:
        known = read_robot(side_file)
        return int(client.add_robot(known.description.model_dump(mode="json"), known.urdf_text)["id"])
    machines = client.machines()
    here = next((one for one in machines["items"] if one["here"]), None)
    if here is None or here["robot_id"] is None:
        raise BadInput("ROBOT", f"name its file: {'; '.join(machines['missing']) or 'the service has no machine'}")
    return int(here["robot_id"])


def tell_subject(planned: Json) -> None:
    """Robot, cell and machine of a plan of the service, and which limits its drive profile narrows, to stderr."""
    sys.stderr.write(f"{plan_subject(planned['robot_id'], planned['document']).sentence}\n")
    made_for: Json | None = planned["document"]["made_for"]
    if made_for is not None and made_for["narrowed"]:
        sys.stderr.write(f"narrower limits of the drive profile, which the plan keeps: {made_for['narrowed']}\n")
