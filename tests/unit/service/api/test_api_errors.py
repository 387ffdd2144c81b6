"""Every refusal is a problem document that names place, value and limit, and leaves nothing stored."""

import json
import socket
from typing import Any
from urllib.parse import urlsplit

import httpx
import pytest

from service.api.gate import BODY_LIMIT, ROBOT_LIMIT
from service.robot import Robot


def problem(response: httpx.Response, status: int) -> dict[str, Any]:
    assert response.status_code == status, response.text
    assert response.headers["content-type"] == "application/problem+json"
    document = response.json()
    assert document["status"] == status
    assert document["instance"] == response.url.path
    return document


def robots(http: httpx.Client) -> int:
    return len(http.get("/robots").json()["items"])


def body(robot: Robot) -> dict[str, Any]:
    return {"description": robot.description.model_dump(mode="json"), "urdf_text": robot.urdf_text}


def test_a_field_out_of_its_limit_is_named_with_value_and_limit(http: httpx.Client, robot: Robot) -> None:
    before, wrong = robots(http), body(robot)
    wrong["description"]["axes"][1]["rated_effort"] = -3.0
    found = problem(http.post("/robots", json=wrong), 422)
    (error,) = found["errors"]
    assert error["pointer"] == "#/description/axes/1/rated_effort"
    assert (error["value"], error["limit"]) == (-3.0, 1e-9)
    assert "rated_effort" in str(found["detail"])
    assert robots(http) == before


def test_a_misspelt_field_is_refused(http: httpx.Client, robot: Robot) -> None:
    before = robots(http)
    found = problem(http.post("/robots", json=body(robot) | {"urdf_txt": ""}), 422)
    assert [error["pointer"] for error in found["errors"]] == ["#/urdf_txt"]
    assert robots(http) == before


def test_a_robot_whose_urdf_does_not_fit_is_refused_with_the_place(http: httpx.Client, robot: Robot) -> None:
    before, wrong = robots(http), body(robot)
    wrong["urdf_text"] = "<robot"
    found = problem(http.post("/robots", json=wrong), 422)
    assert "not XML" in str(found["detail"])
    assert robots(http) == before


@pytest.mark.parametrize("content", [b"{", b"\xff\xfe", b"[" * 100_000])
def test_what_is_not_json_is_a_problem(http: httpx.Client, content: bytes) -> None:
    answer = http.post("/robots", content=content, headers={"Content-Type": "application/json"})
    assert answer.status_code in (400, 422)
    problem(answer, answer.status_code)


def test_half_a_surrogate_pair_is_refused_in_an_answer_that_can_be_sent(http: httpx.Client) -> None:
    headers = {"Content-Type": "application/json"}
    found = problem(http.post("/campaigns", content=b'{"plan_id": "\\ud800"}', headers=headers), 422)
    assert [error["pointer"] for error in found["errors"]] == ["#/plan_id"]


@pytest.mark.parametrize("number", [2**31, 2**63, 10**25])
def test_a_number_that_no_row_can_have_is_refused(http: httpx.Client, number: int) -> None:
    for path in (f"/robots/{number}", f"/campaigns/{number}/bundle", f"/campaigns/1/sweeps/{number}"):
        problem(http.get(path), 422)
    for path in (f"/plans?after={number}", f"/events?after={number}", f"/events?campaign={number}"):
        problem(http.get(path), 422)
    problem(http.get("/events", headers={"Last-Event-ID": str(number)}), 422)
    (error,) = problem(http.post("/campaigns", json={"plan_id": number}), 422)["errors"]
    assert (error["pointer"], error["limit"]) == ("#/plan_id", 2**31 - 1)


@pytest.mark.parametrize("tag", [b'"\xb2"', b'"' + b"9" * 5000 + b'"', b"3"])
def test_what_is_no_etag_is_refused(http: httpx.Client, tag: bytes) -> None:
    answer = http.post("/campaigns/1/start", headers=[(b"If-Match", tag)])
    assert "header/If-Match" in str(problem(answer, 422)["detail"])


def test_what_does_not_exist_is_404_by_name(http: httpx.Client) -> None:
    assert "robot 99" in str(problem(http.get("/robots/99"), 404)["detail"])
    assert "campaign 99" in str(problem(http.get("/campaigns/99/sweeps"), 404)["detail"])
    assert "joint_9" in str(problem(http.post("/drives/joint_9/acknowledge"), 404)["detail"])
    problem(http.get("/no-such-noun"), 404)
    problem(http.delete("/robots"), 405)


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


def test_a_command_without_a_machine_says_why(http: httpx.Client) -> None:
    assert "could not be opened" in str(problem(http.post("/drives/connect"), 503)["detail"])
    assert "not connected" in str(problem(http.post("/drives/joint_1/acknowledge"), 409)["detail"])


@pytest.mark.parametrize(("path", "limit"), [("/robots", ROBOT_LIMIT), ("/plans", BODY_LIMIT)])
def test_a_body_that_is_too_large_is_refused_unread(http: httpx.Client, path: str, limit: int) -> None:
    found = problem(http.post(path, content=b" " * (limit + 1)), 413)
    assert str(limit) in str(found["detail"])


def test_an_answer_does_not_grow_with_what_was_sent(http: httpx.Client) -> None:
    wanted = {"robot_id": 1, "axes": [{} for _ in range(20_000)], "x" * 20_000: "y" * 20_000}
    refused = http.post("/plans", json=wanted)
    found = problem(refused, 422)
    assert len(refused.content) < 2**13
    assert "errors, the first 8 are listed" in str(found["detail"])


def test_a_body_of_unknown_length_is_counted(http: httpx.Client) -> None:
    def pieces():
        for _ in range(ROBOT_LIMIT // 2**16 + 1):
            yield b" " * 2**16

    problem(http.post("/robots", content=pieces(), headers={"Content-Type": "application/json"}), 413)


def test_a_page_of_another_origin_may_not_command_but_may_stop(http: httpx.Client) -> None:
    foreign = {"Origin": "http://elsewhere.example"}
    assert "elsewhere" in str(problem(http.post("/drives/connect", headers=foreign), 403)["detail"])
    assert http.post("/stop", headers=foreign).status_code == 503  # there is no machine
    release_all(http)


def test_a_foreign_host_name_is_refused(http: httpx.Client) -> None:
    assert "rebound" in str(problem(http.get("/robots", headers={"Host": "rebound.example"}), 403)["detail"])


@pytest.mark.parametrize("headers", [{"Host": "[::1"}, {"Origin": "http://["}])
def test_what_is_no_address_is_refused(http: httpx.Client, headers: dict[str, str]) -> None:
    problem(http.get("/robots", headers=headers), 403)


def test_the_stop_waits_for_no_body(url: str) -> None:
    """A body is announced and never sent."""
    parts = urlsplit(url)
    with socket.create_connection((parts.hostname, parts.port), timeout=10) as connection:
        connection.sendall(
            b"POST /api/v1/stop HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\n"
            b"Content-Length: 1000\r\n\r\n{"
        )
        head, _, content = connection.recv(65536).partition(b"\r\n\r\n")
        assert b" 503 " in head.splitlines()[0]  # there is no machine
        while True:
            try:
                assert json.loads(content)["unconfirmed"]
                break
            except ValueError:
                content += connection.recv(65536)
    with httpx.Client(base_url=f"{url}/api/v1", timeout=60, trust_env=False) as http:
        release_all(http)


def release_all(http: httpx.Client) -> None:
    stops = [stop["id"] for stop in http.get("/stop").json()["stops"]]
    assert http.post("/stop/reset", json={"by": "test", "stops": stops}).json()["latched"] is False


@pytest.mark.slow
@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("gear_ratio", 1e308),
        ("gear_ratio", -5e-324),
        ("motor_inertia", 1e308),
        ("rated_effort", 5e-324),
        ("cogging_orders", [1e308]),
        ("joint", "a\u0000b"),
    ],
)
def test_numbers_and_names_of_no_robot_are_refused(http: httpx.Client, robot: Robot, field: str, value: object) -> None:
    before, wrong = robots(http), body(robot)
    wrong["description"]["axes"][1][field] = value
    assert f"#/description/axes/1/{field}" in str(problem(http.post("/robots", json=wrong), 422)["errors"])
    assert robots(http) == before


@pytest.mark.parametrize("velocity", [5e-324, 1e308])
def test_a_velocity_that_no_axis_moves_at_is_refused(http: httpx.Client, velocity: float) -> None:
    plan = {"robot_id": 1, "axes": ["joint_1"], "varied": ["joint_2"], "poses": 1, "move_velocity": velocity}
    assert "move_velocity" in str(problem(http.post("/plans", json=plan), 422)["errors"])


def test_a_urdf_that_names_a_mesh_makes_no_plan_and_opens_no_file(http: httpx.Client, robot: Robot) -> None:
    new = body(robot)
    start = str(new["urdf_text"]).index("<geometry>")
    shape = '<geometry><mesh filename="/proc/self/environ"/></geometry>'
    new["urdf_text"] = robot.urdf_text[:start] + shape + robot.urdf_text[robot.urdf_text.index("</geometry>") + 11 :]
    added = http.post("/robots", json=new)
    assert added.status_code == 201, added.text
    plan = {"robot_id": added.json()["id"], "axes": ["joint_1"], "varied": ["joint_2"], "poses": 1}
    assert "mesh" in str(problem(http.post("/plans", params={"confirm_robot": robot.name}, json=plan), 422)["detail"])
