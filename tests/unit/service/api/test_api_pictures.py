"""What a plan looks like before it moves, how an estimate became better, and which cells there are."""

import itertools
import math
from pathlib import Path

import httpx
import pytest

from service.client import ServiceClient
from tests.system.rest_bench import until
from tests.unit.service.api.conftest import CONFIG
from tests.unit.service.api.test_api_bundles import ZIP, packed

pytestmark = pytest.mark.slow

AXES = {"axes": ["joint_2"], "varied": ["joint_2", "joint_3"], "step": 15.0, "poses": 2}


@pytest.fixture
def plan(http: httpx.Client) -> dict[str, object]:
    robot = next(robot["id"] for robot in http.get("/robots").json()["items"] if robot["name"] == "max100-class")
    answer = http.post("/plans", json=AXES | {"robot_id": robot})
    assert answer.status_code == 201, answer.text
    return dict(answer.json())


def area(corners: list[list[float]]) -> float:
    """By the shoelace formula; positive counter-clockwise."""
    turned = corners[1:] + corners[:1]
    return sum(x * v - u * y for (x, y), (u, v) in zip(corners, turned, strict=True)) / 2


def test_the_picture_of_a_sweep_is_the_arm_in_its_pose(http: httpx.Client, plan: dict[str, object]) -> None:
    document = http.get(f"/plans/{plan['id']}").json()["document"]
    picture = http.get(f"/plans/{plan['id']}/picture", params={"sweep": 2}).json()
    sweep = document["sweeps"][1]
    assert picture["pose"] == pytest.approx(sweep["spec"]["pose"])
    assert (picture["step"], picture["moves"]) == (len(sweep["legs"]), sweep["legs"][-1]["joint"])
    assert {"link_1", "link_2", "link_3", "link_6"} <= {one["name"] for one in picture["robot"]}
    assert "machining table" in {one["name"] for one in picture["cell"]}
    assert all(area(one[view]) > 0 for one in (*picture["robot"], *picture["cell"]) for view in ("side", "above"))
    assert picture["floor"] is not None


def test_joint_1_turns_the_silhouette_from_above_and_each_leg_has_its_step(
    http: httpx.Client, plan: dict[str, object]
) -> None:
    steps = http.get(f"/plans/{plan['id']}/picture").json()["steps"]
    assert steps >= 1
    seen = [
        http.get(f"/plans/{plan['id']}/picture", params={"sweep": 1, "step": step}).json() for step in range(steps + 1)
    ]
    assert seen[0]["moves"] == ""
    assert all(one["moves"] for one in seen[1:])
    for before, after in itertools.pairwise(seen):
        moved = [
            k for k, (a, b) in enumerate(zip(before["pose"], after["pose"], strict=True)) if not math.isclose(a, b)
        ]
        assert [after["joints"][k] for k in moved] in ([after["moves"]], [])
    tip = [one["side"] for one in seen[0]["robot"]][-1]
    assert tip != [one["side"] for one in seen[-1]["robot"]][-1]


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        ({"sweep": 99}, "sweep 99 does not exist"),
        ({"sweep": 1, "step": 50}, "leg 50 does not exist; sweep 1"),
    ],
)
def test_a_sweep_or_step_that_there_is_not_is_told(
    http: httpx.Client, plan: dict[str, object], asked: dict[str, int], told: str
) -> None:
    answer = http.get(f"/plans/{plan['id']}/picture", params=asked)
    assert answer.status_code == 404
    assert told in answer.json()["detail"]


def test_the_grid_names_chosen_free_and_colliding_poses(http: httpx.Client, plan: dict[str, object]) -> None:
    answer = http.get(f"/plans/{plan['id']}/grid").json()
    document = http.get(f"/plans/{plan['id']}").json()["document"]
    states = [pose["state"] for pose in answer["poses"]]
    assert answer["varied"] == ["joint_2", "joint_3"]
    assert answer["total"] == len(states) == document["candidates"]
    assert states.count("chosen") == 2
    assert states.count("chosen") + states.count("free") == document["measurable"]
    assert states.count("collides") > 0


def test_the_cells_are_named(http: httpx.Client) -> None:
    assert http.get("/cells").json()["names"] == sorted(file.stem for file in (CONFIG / "cells").glob("*.yaml"))


def test_the_convergence_of_a_campaign_has_a_line_a_revision(http: httpx.Client, url: str, bundle: Path) -> None:
    answer = http.post("/bundles", content=packed(bundle), headers=ZIP)
    assert answer.status_code == 201, answer.text
    campaign = int(answer.json()["id"])
    with ServiceClient(url) as client:
        until(lambda: client.campaign(campaign)["state"] == "completed", "the identification")
        estimates = client.estimates(campaign)
    told = http.get(f"/campaigns/{campaign}/estimates/convergence").json()
    assert told["wanted"] is None
    assert [(one["revision"], one["sweep"]) for one in told["revisions"]] == [
        (one["revision"], one["number"]) for one in estimates
    ]
    for one, estimate in zip(told["revisions"], estimates, strict=True):
        percent = estimate["document"]["axes"]["joint_1"]["confidence_percent"]
        assert one["percent"] == {"joint_1": None if percent is None else pytest.approx(percent)}
    assert http.get("/campaigns/2000000/estimates/convergence").status_code == 404
