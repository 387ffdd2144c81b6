"""Plans by budget and of other kinds, what one looks like before it moves, and the command.

What is refused stands in `test_api_errors`.
"""

import itertools
import math
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import httpx
import pytest

from service.model.configuration import read_robot
from tests.command import sweepid
from tests.unit.service.hosting import CONFIG

pytestmark = pytest.mark.slow

ROBOT = str(CONFIG / "robots" / "max100-class.yaml")
AXES = {"axes": ["joint_2"], "varied": ["joint_3"], "step": 10.0}
TWO = {"axes": ["joint_2"], "varied": ["joint_2", "joint_3"], "step": 15.0, "poses": 2}
TRAJECTORY = {"kind": "trajectory", "axes": ["joint_3", "joint_5"], "trajectories": 1, "period": 2.0, "harmonics": 3}


def made(http: httpx.Client, wanted: dict[str, Any], **typed: Any) -> dict[str, Any]:
    robots = http.get("/robots").json()["items"]
    robot = next(one["id"] for one in robots if one["name"] == "max100-class")
    answer = http.post("/plans", params=typed, json={"robot_id": robot} | wanted)
    assert answer.status_code == 201, answer.text
    return answer.json()


@pytest.fixture(scope="module")
def plan(url: str) -> dict[str, Any]:
    with httpx.Client(base_url=f"{url}/api/v1", timeout=60, trust_env=False) as http:
        return made(http, TWO)


def test_other_kinds_are_planned(http: httpx.Client) -> None:
    trajectories = made(http, TRAJECTORY)["document"]["sweeps"]
    assert [sweep["spec"]["block"] for sweep in trajectories] == ["trajectory 1 of 2 axes"] * 2
    diagnosis = made(http, AXES | {"kind": "diagnosis", "poses": 1, "blocks": ["reversal", "wide"]})
    sweeps = diagnosis["document"]["sweeps"]
    assert [sweep["spec"]["block"] for sweep in sweeps] == ["reversal"] * 2 + ["wide"] * 2
    assert http.post("/campaigns", json={"plan_id": diagnosis["id"]}).status_code == 201


def test_a_robot_of_another_machine_is_not_planned(http: httpx.Client, profile: Path) -> None:
    known = read_robot(Path(ROBOT))
    description = known.description.model_dump(mode="json")
    description["axes"][5]["gear_ratio"] = 60.0
    robot = http.post("/robots", json={"description": description, "urdf_text": known.urdf_text}).json()["id"]
    wanted = AXES | {"robot_id": robot, "poses": 1}
    refused = http.post("/plans", json=wanted)
    gear = f"joint_6 gear ratio: robot max100-class (number {robot}) has 60, drive profile {profile} has 101"
    assert refused.status_code == 422, refused.text
    assert refused.json()["detail"].startswith(f"robot_id: belongs to another machine: {gear}")
    assert made(http, wanted, elsewhere=True)


# -- the command


def command(url: str, *options: str) -> CompletedProcess[str]:
    axes = ("--axes", "joint_2", "--varied", "joint_3", "--step", "10")
    return sweepid("plan", ROBOT, *axes, "--url", url, *options)


def test_the_command_tells_what_the_plan_promises(url: str, http: httpx.Client) -> None:
    done = command(url, "--duration", "60")
    assert done.returncode == 0, done.stderr
    document = http.get(f"/plans/{done.stdout.strip()}").json()["document"]
    assert document["duration"] <= 60
    count = f"{len(document['confidence'])} poses, {len(document['sweeps'])} sweeps, 1 min; confidence of J: none"
    assert count in done.stderr
    assert document["undetermined"]
    assert f"not better than CAD for {', '.join(document['undetermined'])}. Plan" in done.stderr


def test_the_command_plans_for_the_machine_and_names_it(url: str, http: httpx.Client) -> None:
    done = sweepid("plan", "--axes", "joint_2", "--varied", "joint_3", "--step", "30", "--poses", "1", "--url", url)
    assert done.returncode == 0, done.stderr
    plan = http.get(f"/plans/{done.stdout.strip()}").json()
    told = f"robot max100-class (number {plan['robot_id']}) in cell workshop, machine machine\n"
    assert done.stderr.startswith(told)
    made_for = plan["document"]["made_for"]
    assert "joint_1 velocity limit 1 instead of 1.9 rad/s" in made_for.pop("narrowed")
    assert made_for == {"machine": "machine", "confirmed": {}, "by": ""}


def test_the_command_refuses_what_does_not_go_together(url: str) -> None:
    done = command(url, "--diagnosis", "--initial-analysis")
    assert (done.returncode, done.stdout) == (2, "")
    assert "--diagnosis: cannot be combined with --initial-analysis" in done.stderr


# -- what it looks like


def area(corners: list[list[float]]) -> float:
    """By the shoelace formula; positive counter-clockwise."""
    turned = corners[1:] + corners[:1]
    return sum(x * v - u * y for (x, y), (u, v) in zip(corners, turned, strict=True)) / 2


def test_the_picture_of_a_sweep_is_the_arm_in_its_pose(http: httpx.Client, plan: dict[str, Any]) -> None:
    picture = http.get(f"/plans/{plan['id']}/picture", params={"sweep": 2}).json()
    sweep = plan["document"]["sweeps"][1]
    assert picture["pose"] == pytest.approx(sweep["spec"]["pose"])
    assert (picture["step"], picture["moves"]) == (len(sweep["legs"]), sweep["legs"][-1]["joint"])
    assert {"link_1", "link_2", "link_3", "link_6"} <= {one["name"] for one in picture["robot"]}
    assert "machining table" in {one["name"] for one in picture["cell"]}
    assert all(area(one[view]) > 0 for one in (*picture["robot"], *picture["cell"]) for view in ("side", "above"))
    assert picture["floor"] is not None


def test_each_leg_has_its_step_and_moves_its_joint_alone(http: httpx.Client, plan: dict[str, Any]) -> None:
    path = f"/plans/{plan['id']}/picture"
    steps = http.get(path).json()["steps"]
    assert steps >= 1
    seen = [http.get(path, params={"sweep": 1, "step": step}).json() for step in range(steps + 1)]
    assert seen[0]["moves"] == ""
    assert all(one["moves"] for one in seen[1:])
    for before, after in itertools.pairwise(seen):
        poses = enumerate(zip(before["pose"], after["pose"], strict=True))
        moved = [k for k, (a, b) in poses if not math.isclose(a, b)]
        assert [after["joints"][k] for k in moved] in ([after["moves"]], [])
    assert seen[0]["robot"][-1]["side"] != seen[-1]["robot"][-1]["side"]
    for asked, told in (({"sweep": 99}, "sweep 99 does not exist"), ({"step": 50}, "leg 50 does not exist; sweep 1")):
        answer = http.get(path, params={"sweep": 1, **asked})
        assert (answer.status_code, told in answer.json()["detail"]) == (404, True)


def test_the_grid_names_chosen_free_and_colliding_poses(http: httpx.Client, plan: dict[str, Any]) -> None:
    answer, document = http.get(f"/plans/{plan['id']}/grid").json(), plan["document"]
    states = [pose["state"] for pose in answer["poses"]]
    assert answer["varied"] == ["joint_2", "joint_3"]
    assert answer["total"] == len(states) == document["candidates"]
    assert states.count("chosen") == 2
    assert states.count("chosen") + states.count("free") == document["measurable"]
    assert states.count("collides") > 0
    assert http.get("/cells").json()["names"] == sorted(file.stem for file in (CONFIG / "cells").glob("*.yaml"))
