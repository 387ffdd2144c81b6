"""A request is of the epoch in which it arrived, or of that which the person saw, whatever it waits for."""

import socket
from collections.abc import Iterator

import httpx
import pytest

from service.api.machine.arrival import EPOCH, Arrival
from service.app import create_app
from service.client import ServiceClient
from service.settings import Settings
from tests.system.rest_bench import add_plan

SUPERSEDED = "urn:sweepid:problem:superseded"


@pytest.fixture(scope="module")
def campaign(url: str) -> int:
    with ServiceClient(url) as client:
        return int(client.add_campaign(add_plan(client, axes=["joint_1"], poses=1))["id"])


@pytest.fixture
def released(http: httpx.Client) -> Iterator[None]:
    yield
    stops = [stop["id"] for stop in http.get("/stop").json()["stops"]]
    if stops:
        http.post("/stop/reset", json={"by": "anna", "stops": stops}).raise_for_status()


def epoch(http: httpx.Client) -> str:
    return str(http.get("/stop").json()["epoch"])


@pytest.mark.parametrize("origins", [(), ("https://example.org",)])
def test_nothing_comes_before_the_arrival(origins: tuple[str, ...]) -> None:
    app = create_app(Settings(cors_origins=origins))
    assert app.user_middleware[0].cls is Arrival


@pytest.mark.usefixtures("released")
def test_a_stop_begins_an_epoch_and_its_release_none(http: httpx.Client) -> None:
    before = epoch(http)
    assert http.get("/drives").json()["epoch"] == epoch(http) == before
    http.post("/stop", params={"by": "anna"})
    stopped = epoch(http)
    assert stopped != before
    (stop,) = http.get("/stop").json()["stops"]
    assert http.post("/stop/reset", json={"by": "anna", "stops": [stop["id"]]}).json()["epoch"] == stopped


@pytest.mark.usefixtures("released")
def test_the_events_of_a_stop_have_the_present_epoch(http: httpx.Client, url: str) -> None:
    http.post("/stop", params={"by": "berta"})
    with ServiceClient(url) as client:
        stops = (event for event in client.events() if event["kind"] == "stop" and event["data"]["by"] == "berta")
        assert next(stops)["data"]["epoch"] == epoch(http)


@pytest.mark.usefixtures("released")
def test_what_a_person_wanted_who_did_not_see_the_stop_is_refused(http: httpx.Client, campaign: int) -> None:
    seen = {EPOCH: epoch(http)}
    http.post("/stop", params={"by": "anna", "why": "smoke"})
    http.post("/stop/reset", json={"by": "anna", "stops": [http.get("/stop").json()["stops"][0]["id"]]})
    plan = http.get(f"/campaigns/{campaign}").json()["plan_id"]
    approval = {"sha256": http.get(f"/plans/{plan}/approvals").json()["sha256"], "approved_by": "anna"}
    for path, body in ((f"/campaigns/{campaign}/start", {}), (f"/plans/{plan}/approvals", approval)):
        refused = http.post(path, json=body, headers=seen)
        assert (refused.status_code, refused.json()["type"]) == (409, SUPERSEDED)
        assert "stopped by anna: smoke" in refused.json()["detail"]
        assert "give the command again" in refused.json()["detail"]
    assert http.get(f"/plans/{plan}/approvals").json()["items"] == []
    seen = {EPOCH: epoch(http)}
    assert http.post(f"/plans/{plan}/approvals", json=approval, headers=seen).status_code == 201
    assert http.post(f"/campaigns/{campaign}/start", json={}, headers=seen).status_code == 503  # no drive answers
    nobodys = http.post(f"/campaigns/{campaign}/start", json={}, headers={EPOCH: "of another service"})
    assert (nobodys.status_code, nobodys.json()["type"]) == (409, SUPERSEDED)


@pytest.mark.usefixtures("released")
def test_a_start_whose_body_comes_after_a_stop_is_older_than_the_stop(
    http: httpx.Client, url: str, campaign: int
) -> None:
    server = httpx.URL(url)
    head = (
        f"POST /api/v1/campaigns/{campaign}/start HTTP/1.1\r\nHost: {server.host}:{server.port}\r\n"
        "Content-Type: application/json\r\nContent-Length: 2\r\nExpect: 100-continue\r\nConnection: close\r\n\r\n"
    )
    with socket.create_connection((server.host, server.port), timeout=30) as line, line.makefile("rb") as answers:
        line.sendall(head.encode())
        assert b" 100 " in answers.readline()  # the service waits for the body
        http.post("/stop", params={"by": "anna", "why": "smoke"})
        http.post("/stop/reset", json={"by": "anna", "stops": [http.get("/stop").json()["stops"][0]["id"]]})
        line.sendall(b"{}")
        answer = answers.read()
    assert b" 409 " in answer
    assert SUPERSEDED.encode() in answer
