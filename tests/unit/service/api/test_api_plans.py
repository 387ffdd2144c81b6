"""Plans by budget, through the API and by the command."""

import re
from pathlib import Path
from subprocess import CompletedProcess

import httpx
import pytest

from service.configuration import read_robot
from tests.command import sweepid
from tests.unit.service.api.conftest import CONFIG, serving

pytestmark = pytest.mark.slow

ROBOT = str(CONFIG / "robots" / "max100-class.yaml")
AXES = {"axes": ["joint_2"], "varied": ["joint_3"], "step": 10.0}


def command(url: str, *options: str) -> CompletedProcess[str]:
    axes = ("--axes", "joint_2", "--varied", "joint_3", "--step", "10")
    return sweepid("plan", ROBOT, *axes, "--url", url, *options)


@pytest.fixture
def robot_id(http: httpx.Client) -> int:
    return next(robot["id"] for robot in http.get("/robots").json()["items"] if robot["name"] == "max100-class")


def test_a_budget_of_confidence_is_planned_and_told(http: httpx.Client, robot_id: int) -> None:
    answer = http.post("/plans", json=AXES | {"robot_id": robot_id, "confidence": 0.5, "criterion": "d_optimal"})
    assert answer.status_code == 201, answer.text
    document = answer.json()["document"]
    assert document["request"]["poses"] is None
    assert document["confidence"][:2] == [None, None]
    assert document["confidence"][-1] <= 0.5 < document["confidence"][-2]


@pytest.mark.parametrize(
    ("budget", "told"),
    [
        ({"poses": 3, "confidence": 1.0}, "poses and confidence are budgets: give one of them"),
        ({"confidence": 0.01}, "confidence: 0.01 % requested, but the best"),
        ({"duration": 2.0}, "duration: 2 s are too short for one pose"),
        ({"criterion": "the_best"}, "criterion"),
    ],
)
def test_a_budget_that_cannot_be_met_names_the_field(
    http: httpx.Client, robot_id: int, budget: dict[str, object], told: str
) -> None:
    answer = http.post("/plans", json=AXES | {"robot_id": robot_id} | budget)
    assert answer.status_code == 422
    assert told in answer.json()["detail"]


def test_a_robot_of_another_machine_is_not_planned(http: httpx.Client, profile: Path) -> None:
    known = read_robot(Path(ROBOT))
    description = known.description.model_dump(mode="json")
    description["axes"][5]["gear_ratio"] = 60.0
    robot = http.post("/robots", json={"description": description, "urdf_text": known.urdf_text}).json()["id"]
    wanted = AXES | {"robot_id": robot, "poses": 1}
    refused = http.post("/plans", json=wanted)
    assert refused.status_code == 422, refused.text
    gear = f"joint_6 gear ratio: robot max100-class (number {robot}) has 60, drive profile {profile} has 101"
    assert refused.json()["detail"].startswith(f"robot_id: belongs to another machine: {gear}")
    assert http.post("/plans", params={"elsewhere": True}, json=wanted).status_code == 201


def test_a_plan_keeps_a_lower_limit_of_the_drive(tmp_path: Path, profile: Path) -> None:
    weaker = tmp_path / "weaker.yaml"
    weaker.write_text(profile.read_text("utf-8").replace("effort_limit: 7000.0", "effort_limit: 6000.0"), "utf-8")
    with serving(tmp_path, weaker) as url, httpx.Client(base_url=f"{url}/api/v1", timeout=60, trust_env=False) as http:
        robots = http.get("/robots").json()["items"]
        robot = next(one["id"] for one in robots if one["name"] == "max100-class")
        for elsewhere, limit in ((False, 6000.0), (True, 7000.0)):
            wanted = AXES | {"robot_id": robot, "poses": 1}
            plan = http.post("/plans", params={"elsewhere": elsewhere}, json=wanted).json()["document"]
            assert [sweep["effort_limit"] for sweep in plan["sweeps"]] == [limit]
            narrowed = "" if elsewhere else plan["made_for"]["narrowed"]
            assert ("joint_2 effort limit 6000 instead of 7000 N m" in narrowed.split("; ")) is not elsewhere


def test_a_mesh_that_the_service_does_not_have_is_told(http: httpx.Client) -> None:
    known = read_robot(Path(ROBOT))
    mesh = '<mesh filename="package://arm/meshes/forearm.stl"/>'
    text = re.sub(r'<cylinder radius="0.10" length="0.52"/>', mesh, known.urdf_text)
    assert text != known.urdf_text
    description = known.description.model_dump(mode="json")
    robot = http.post("/robots", json={"description": description, "urdf_text": text})
    assert robot.status_code == 201, robot.text
    typed = {"confirm_robot": known.name}  # a changed description is another robot
    answer = http.post("/plans", params=typed, json=AXES | {"robot_id": robot.json()["id"], "poses": 2})
    assert answer.status_code == 422, answer.text
    assert "link link_4: mesh package://arm/meshes/forearm.stl: its shape is not in the URDF" in answer.json()["detail"]


def test_the_command_tells_what_the_plan_promises(url: str, http: httpx.Client) -> None:
    done = command(url, "--duration", "60")
    assert done.returncode == 0, done.stderr
    document = http.get(f"/plans/{done.stdout.strip()}").json()["document"]
    assert document["duration"] <= 60
    assert (
        f"{len(document['confidence'])} poses, {len(document['sweeps'])} sweeps, 1 min; J may not be known"
        in done.stderr
    )
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


def test_the_command_refuses_two_budgets(url: str) -> None:
    done = command(url, "--poses", "2", "--confidence", "1")
    assert (done.returncode, done.stdout) == (2, "")
    assert "poses and confidence are budgets: give one of them" in done.stderr


def test_trajectories_of_several_axes_are_planned(http: httpx.Client, robot_id: int) -> None:
    wanted = {"kind": "trajectory", "robot_id": robot_id, "axes": ["joint_3", "joint_5"], "trajectories": 1}
    quick = wanted | {"period": 2.0, "harmonics": 3}
    answer = http.post("/plans", json=quick)
    assert answer.status_code == 201, answer.text
    blocks = [sweep["spec"]["block"] for sweep in answer.json()["document"]["sweeps"]]
    assert blocks == ["trajectory 1 of 2 axes"] * 2
    for change, told in (
        ({"axes": ["joint_3", "joint_9"]}, "unknown joint joint_9"),
        ({"harmonics": 1}, "harmonics: 1 are too few to determine the 13 base parameters of the axes"),
        ({"sweeps": 99}, "99"),
        ({"velocity": 2.0}, "velocity"),
    ):
        refused = http.post("/plans", json=quick | change)
        assert refused.status_code == 422, refused.text
        assert told in refused.text


def test_the_sweeps_of_a_diagnosis_are_planned(http: httpx.Client, robot_id: int) -> None:
    wanted = AXES | {"kind": "diagnosis", "robot_id": robot_id, "poses": 1, "blocks": ["reversal", "wide"]}
    answer = http.post("/plans", json=wanted)
    assert answer.status_code == 201, answer.text
    document = answer.json()["document"]
    assert [sweep["spec"]["block"] for sweep in document["sweeps"]] == ["reversal"] * 2 + ["wide"] * 2
    campaign = http.post("/campaigns", json={"plan_id": answer.json()["id"]})
    assert campaign.status_code == 201, campaign.text
    refused = http.post("/plans", json=wanted | {"blocks": ["sideways"]})
    assert refused.status_code == 422
    assert "blocks: unknown block sideways" in refused.json()["detail"]


def test_the_command_refuses_two_kinds_of_plan(url: str) -> None:
    done = command(url, "--diagnosis", "--initial-analysis")
    assert (done.returncode, done.stdout) == (2, "")
    assert "--diagnosis: cannot be combined with --initial-analysis" in done.stderr
