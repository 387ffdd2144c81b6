"""Every refusal is a problem document that names place, value and limit, stays small, and leaves nothing stored."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import httpx
import pytest

from service.model.configuration import read_robot
from service.web.api.gate import ROBOT_LIMIT, Gate
from tests.unit.service.api.conftest import ZIP
from tests.unit.service.hosting import CONFIG

ROBOT = read_robot(CONFIG / "robots" / "max100-class.yaml")
JSON = {"Content-Type": "application/json"}
THIS = "max100-class"  # stands for the robot's number
BUDGET = {"robot_id": THIS, "axes": ["joint_2"], "varied": ["joint_3"], "step": 10.0}
TRAJECTORY = {
    **{"kind": "trajectory", "robot_id": THIS, "axes": ["joint_3", "joint_5"], "trajectories": 1},
    **{"period": 2.0, "harmonics": 3},
}


@dataclass(frozen=True)
class Asked:
    """A request, and what is told of it."""

    method: str
    path: str
    status: int
    words: str = ""
    """In its detail, or in the list of its errors."""
    error: dict[str, Any] = field(default_factory=dict[str, Any])
    """What the first of these has."""
    options: dict[str, Any] = field(default_factory=dict[str, Any])


def robots(
    told: str = "", error: dict[str, Any] | None = None, axis: dict[str, Any] | None = None, **body: Any
) -> Asked:
    """A description that is refused: changed in an axis, or elsewhere."""
    description = ROBOT.description.model_dump(mode="json")
    description["axes"][1] |= axis or {}
    sent = {"description": description, "urdf_text": ROBOT.urdf_text} | body
    return Asked("POST", "/robots", 422, told, error or {}, {"json": sent})


def plan(told: str, body: dict[str, Any], **change: Any) -> Asked:
    return Asked("POST", "/plans", 422, told, {}, {"json": body | change})


def content(path: str, status: int, sent: Any, told: str = "") -> Asked:
    return Asked("POST", path, status, told, {}, {"content": sent, "headers": JSON})


def headed(method: str, path: str, status: int, headers: Any, told: str = "", **more: Any) -> Asked:
    return Asked(method, path, status, told, {}, {"headers": headers} | more)


def pieces() -> Iterator[bytes]:
    for _ in range(ROBOT_LIMIT // 2**16 + 1):
        yield b" " * 2**16


ASKED = {
    "a field out of its limit": robots(
        "rated_effort",
        {"pointer": "#/description/axes/1/rated_effort", "value": -3.0, "limit": 1e-9},
        {"rated_effort": -3.0},
    ),
    "a misspelt field": robots(error={"pointer": "#/urdf_txt"}, urdf_txt=""),
    "a URDF that is none": robots("not XML", urdf_text="<robot"),
    **{
        f"{field} {value}": robots(f"#/description/axes/1/{field}", axis={field: value})
        for field, value in (
            *(("gear_ratio", 1e308), ("gear_ratio", -5e-324), ("motor_inertia", 1e308), ("rated_effort", 5e-324)),
            *(("cogging_orders", [1e308]), ("joint", "a\u0000b")),
        )
    },
    "half an object": content("/robots", 422, b"{"),
    "no UTF-8": content("/robots", 422, b"\xff\xfe"),
    "deep": content("/robots", 400, b"[" * 100_000),
    "half a surrogate pair": Asked(
        "POST", "/campaigns", 422, "", {"pointer": "#/plan_id"},
        {"content": b'{"plan_id": "\\ud800"}', "headers": JSON},
    ),
    "a large robot": content("/robots", 413, b" " * (ROBOT_LIMIT + 1), str(ROBOT_LIMIT)),
    "a large plan": content("/plans", 413, b" " * (Gate.body_limit + 1), str(Gate.body_limit)),
    "of unknown length": content("/robots", 413, pieces),
    "many errors": plan(
        "errors, the first 8 are listed",
        {"robot_id": 1, "axes": [{} for _ in range(20_000)], "x" * 20_000: "y" * 20_000},
    ),
    **{
        f"{number} {path}": Asked("GET", path.format(number), 422)
        for number in (2**31, 2**63, 10**25)
        for path in (
            *("/robots/{}", "/campaigns/{}/bundle", "/campaigns/1/sweeps/{}"),
            *("/plans?after={}", "/events?after={}", "/events?campaign={}"),
        )
    },
    **{
        f"{number} in a body": Asked(
            "POST", "/campaigns", 422, "", {"pointer": "#/plan_id", "limit": 2**31 - 1}, {"json": {"plan_id": number}}
        )
        for number in (2**31, 2**63, 10**25)
    },
    **{
        f"event {event}": headed("GET", "/events", 422, {"Last-Event-ID": event})
        for event in ("x", str(2**31), str(10**25))
    },
    **{
        f"version {tag[:9]!r}": headed("POST", "/campaigns/1/start", 422, [(b"If-Match", tag)], "header/If-Match")
        for tag in (b'"\xb2"', b'"' + b"9" * 5000 + b'"', b"3")
    },
    "a robot that is not": Asked("GET", "/robots/99", 404, "robot 99"),
    "a campaign that is not": Asked("GET", "/campaigns/99999/sweeps", 404, "campaign 99999"),
    "its model": Asked("GET", "/campaigns/99999/model.urdf", 404),
    "its report": Asked("GET", "/campaigns/99999/report", 404, "campaign 99999 does not exist"),
    "its convergence": Asked("GET", "/campaigns/99999/estimates/convergence", 404),
    "a diagnosis that is not": Asked("GET", "/diagnoses/99999", 404),
    "a model that is not": Asked("GET", "/models/99999", 404),
    "a payload that is not": Asked("GET", "/payloads/99999", 404),
    "a job that is not": Asked("GET", "/jobs/99999", 404),
    "its end": Asked("POST", "/jobs/99999/cancel", 404),
    "a job of what is not": Asked("POST", "/jobs", 404, "", {}, {"json": {"campaigns": [99999]}}),
    "a joint that is not": Asked("POST", "/drives/joint_9/acknowledge", 404, "joint_9"),
    "a noun that is not": Asked("GET", "/no-such-noun", 404),
    **{
        f"no type {path}": Asked("GET", f"{path}?type=nobody", 404, "no robot of the type 'nobody'; the types are: ")
        for path in ("/fleet", "/fleet/report", "/fleet/report.json")
    },
    "too many at once": Asked("GET", "/campaigns?limit=201", 422),
    "a form that is not": Asked("GET", "/campaigns/1/model.sdf", 422),
    "a report that is not": Asked("GET", "/campaigns/1/report.docx", 422),
    "a kind of job": Asked("POST", "/jobs", 422, "", {}, {"json": {"kind": "nothing"}}),
    "no zip": headed("POST", "/bundles", 422, ZIP, "bundle", content=b"no zip"),
    "no campaigns": Asked("POST", "/diagnoses", 422, "#/campaigns", {}, {"json": {"campaigns": []}}),
    "a lost campaign": Asked(
        *("POST", "/diagnoses", 422, "campaigns: campaign 99999 does not exist", {}), {"json": {"campaigns": [99999]}}
    ),
    "no machine to connect": Asked("POST", "/drives/connect", 503, "could not be opened"),
    "no machine to ask": Asked("POST", "/drives/joint_1/acknowledge", 409, "not connected"),
    "a foreign page": headed("POST", "/drives/connect", 403, {"Origin": "http://elsewhere.example"}, "elsewhere"),
    "a foreign name": headed("GET", "/robots", 403, {"Host": "rebound.example"}, "rebound"),
    "a name that is none": headed("GET", "/robots", 403, {"Host": "[::1"}),
    "a page that is none": headed("GET", "/robots", 403, {"Origin": "http://["}),
    "two budgets": plan("poses and confidence are budgets: give one of them", BUDGET, poses=3, confidence=1.0),
    "too sure": plan("confidence: 0.01 % requested, but the best", BUDGET, confidence=0.01),
    "too short": plan("duration: 2 s are too short for one pose", BUDGET, duration=2.0),
    "an unknown criterion": plan("criterion", BUDGET, criterion="the_best"),
    "too slow": plan("move_velocity", BUDGET, poses=1, move_velocity=5e-324),
    "too fast": plan("move_velocity", BUDGET, poses=1, move_velocity=1e308),
    "an unknown block": plan("unknown block sideways", BUDGET, kind="diagnosis", poses=1, blocks=["sideways"]),
    "an unknown joint": plan("unknown joint joint_9", TRAJECTORY, axes=["joint_3", "joint_9"]),
    "one harmonic": plan(
        "harmonics: 1 are too few to determine the 13 base parameters of the axes", TRAJECTORY, harmonics=1
    ),
    "too many sweeps": plan("99", TRAJECTORY, sweeps=99),
    **{
        f"moves too fast, {len(of)}": plan("move_velocity: 0.6 is above the limit 0.5", of, move_velocity=0.6)
        for of in (BUDGET | {"poses": 1}, TRAJECTORY)
    },
    "a velocity too many": plan("velocity", TRAJECTORY, velocity=2.0),
}  # fmt: skip


def number_of(http: httpx.Client) -> int:
    return next(robot["id"] for robot in http.get("/robots").json()["items"] if robot["name"] == THIS)


def stored(http: httpx.Client) -> list[int]:
    return [
        len(http.get(f"/{noun}", params={"limit": 200}).json()["items"]) for noun in ("robots", "plans", "campaigns")
    ]


def problem(answer: httpx.Response, status: int) -> dict[str, Any]:
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    document = answer.json()
    assert (document["status"], document["instance"]) == (status, answer.url.path)
    assert len(answer.content) < 2**13
    return document


@pytest.mark.parametrize("case", ASKED)
def test_what_is_refused_is_told_and_leaves_nothing(http: httpx.Client, case: str) -> None:
    asked, before = ASKED[case], stored(http)
    options = dict(asked.options)
    if options.get("json", {}).get("robot_id") == THIS:
        options["json"] = options["json"] | {"robot_id": number_of(http)}
    if options.get("content") is pieces:
        options["content"] = pieces()
    document = problem(http.request(asked.method, asked.path, **options), asked.status)
    errors = document.get("errors") or [{}]
    assert asked.words in f"{document['detail']} {errors}"
    assert {name: errors[0][name] for name in asked.error} == asked.error
    assert stored(http) == before


@pytest.mark.parametrize(
    ("path", "methods"),
    [
        ("/robots", "GET, POST"),
        ("/robots/1", "GET"),
        ("/stop", "GET, POST"),
        ("/stop/reset", "POST"),
        ("/drives/joint_1/acknowledge", "POST"),
    ],
)
def test_a_method_that_a_path_has_not_is_told_those_that_it_has(http: httpx.Client, path: str, methods: str) -> None:
    answer = http.delete(path)
    problem(answer, 405)
    assert answer.headers["allow"] == methods


@pytest.mark.parametrize(
    ("shape", "mesh"),
    [
        (r"<geometry>.*?</geometry>", '<geometry><mesh filename="/proc/self/environ"/></geometry>'),
        (r'<cylinder radius="0.10" length="0.52"/>', '<mesh filename="package://arm/meshes/forearm.stl"/>'),
    ],
    ids=["a file of the computer", "a package"],
)
def test_a_mesh_makes_no_plan_and_opens_no_file(http: httpx.Client, shape: str, mesh: str) -> None:
    text = re.sub(shape, mesh, ROBOT.urdf_text, count=1, flags=re.DOTALL)
    added = http.post("/robots", json={"description": ROBOT.description.model_dump(mode="json"), "urdf_text": text})
    assert added.status_code == 201, added.text
    wanted = BUDGET | {"robot_id": added.json()["id"], "poses": 1}
    # a changed description is another robot
    refused = http.post("/plans", params={"confirm_robot": ROBOT.name}, json=wanted)
    name = re.findall('"(.*)"', mesh)[0]
    assert f"mesh {name}: its shape is not in the URDF" in problem(refused, 422)["detail"]
