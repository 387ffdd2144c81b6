"""A stop holds until a person releases it by name, and what was wanted before it is of another epoch.

No machine answers here, so that no stop is confirmed. Some tests need a real server: they hold back a body.
"""

import asyncio
import json
import socket
import sqlite3
import threading
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path

import anyio.to_thread
import httpx
import pytest

from service.process.settings import Settings
from service.store.documents import LARGEST_ID
from service.store.lease_and_latch import StopLatch
from service.web.api.dependencies import EPOCH, Arrival
from service.web.app import create_app
from service.web.client import ServiceClient
from tests.system.rest_bench import add_plan, until
from tests.unit.service.api.conftest import opened

SUPERSEDED = "urn:sweepid:problem:superseded"
HEAD = "POST {} HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\nContent-Length: {}\r\n"


@pytest.fixture(scope="module")
def planned(url: str) -> int:
    return add_campaign(url)


@pytest.fixture
def released(http: httpx.Client) -> Iterator[None]:
    yield
    release_all(http)


def add_campaign(url: str) -> int:
    with ServiceClient(url) as client:
        return int(client.add_campaign(add_plan(client, axes=["joint_1"], poses=1))["id"])


def release_all(http: httpx.Client) -> None:
    if stops := [stop["id"] for stop in http.get("/stop").json()["stops"]]:
        assert http.post("/stop/reset", json={"by": "anna", "stops": stops}).json()["latched"] is False


def epoch(http: httpx.Client) -> str:
    return str(http.get("/stop").json()["epoch"])


def lock(database: Path) -> sqlite3.Connection:
    beside = sqlite3.connect(database, timeout=30, isolation_level=None, check_same_thread=False)
    beside.execute("BEGIN IMMEDIATE")
    return beside


def test_stop_latches_and_a_name_releases(http: httpx.Client) -> None:
    assert http.get("/health/live").json() == {"alive": True}
    (cause,) = http.get("/health/ready").json()["causes"]
    assert "could not be opened" in cause
    before = http.get("/stop").json()
    assert (before["latched"], before["stop"], before["stops"]) == (False, None, [])
    told = http.post("/stop", params={"by": "anna", "why": "smoke"})
    assert told.status_code == 503  # latched, but there is no machine that could say that it stands
    assert all(reason.startswith("not connected: ") for reason in told.json()["unconfirmed"].values())
    assert set(told.json()["unconfirmed"]) == {f"joint_{number}" for number in range(1, 7)}
    held = http.get("/stop").json()
    assert held["latched"] is True
    assert (held["stop"]["by"], held["stop"]["why"]) == ("anna", "smoke")
    ready = http.get("/health/ready")
    assert (ready.status_code, "stopped by anna: smoke" in ready.json()["causes"]) == (503, True)

    # again, with nonsense and from a foreign page; a slash makes no redirection of it
    for way, by in (("/stop", "berta"), ("/stop/", "carl")):
        headers = {"Origin": "http://elsewhere.example"}
        assert http.post(way, params={"by": by}, content=b"\xff not json", headers=headers).status_code == 503
    anna, second, third = (stop["id"] for stop in http.get("/stop").json()["stops"])

    wrong = [{"by": "anna"}, {"by": "anna", "stops": []}, {"by": "anna", "stops": [anna], "force": True}]
    for nobody in (*wrong, *({**name, "stops": [anna]} for name in ({}, {"by": ""}, {"by": "  "}))):
        assert http.post("/stop/reset", json=nobody).status_code == 422
    key = {"Idempotency-Key": "the same again"}
    for _ in range(2):
        reset = http.post("/stop/reset", json={"by": "anna", "stops": [anna]}, headers=key).json()
        assert reset["stop"]["reset_by"] == "anna"
        assert [stop["by"] for stop in reset["stops"]] == ["berta", "carl"]  # those of others hold
    for nobodys in (LARGEST_ID, -LARGEST_ID):
        assert http.post("/stop/reset", json={"by": "anna", "stops": [nobodys]}).status_code == 404
    reset = http.post("/stop/reset", json={"by": "anna", "stops": [second, third]}).json()
    assert (reset["latched"], reset["stops"]) == (False, [])


def test_a_stop_is_answered_without_the_database_and_noted_later(http: httpx.Client, folder: Path) -> None:
    with closing(lock(folder / "data" / "sweepid.sqlite")) as beside:
        assert http.post("/stop", params={"by": "anna", "why": "locked"}).status_code == 503  # no machine, as above
        (held,) = http.get("/stop").json()["stops"]
        beside.execute("ROLLBACK")  # held all the while
        assert held["id"] < 0
        until(lambda: http.get("/stop").json()["stop"]["id"] > 0, "the database has taken it")
        noted = "SELECT by, why, at, reset_by FROM stop ORDER BY id DESC LIMIT 1"
        by, why, at, _ = beside.execute(noted).fetchone()
        assert (by, why) == ("anna", "locked")
        assert at.replace(" ", "T")[:19] == held["at"][:19]  # when it was, not when it was noted
        for _ in range(2):  # by the name that was told first
            reset = http.post("/stop/reset", json={"by": "berta", "stops": [held["id"]]}).json()
            assert (reset["latched"], reset["stop"]["reset_by"]) == (False, "berta")
        assert beside.execute(noted).fetchone()[3] == "berta"


@pytest.mark.slow
async def test_a_lock_that_comes_after_the_entry_in_the_audit(
    tmp_path: Path, profile: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("service.store.lease_and_latch.PATIENCE", 0.2)
    reset, locks = StopLatch.reset, list[sqlite3.Connection]()

    def locked(latch: StopLatch, by: str, stops: Sequence[int]):
        locks.append(lock(tmp_path / "sweepid.sqlite"))
        return reset(latch, by, stops)

    async with opened(tmp_path, profile) as (application, http):
        await http.post("/stop", params={"by": "anna"})
        machine = application.machine
        await machine.noted()
        (stop,) = machine.stops
        monkeypatch.setattr(StopLatch, "reset", locked)
        refused = await http.post("/stop/reset", json={"by": "anna", "stops": [stop.id]})
        for each in locks:
            each.close()
        monkeypatch.setattr(StopLatch, "reset", reset)
        assert (refused.status_code, refused.headers["retry-after"]) == (503, "5")
        assert refused.json()["type"] == "urn:sweepid:problem:not-now"
        assert "the machine stays stopped" in refused.json()["detail"]
        assert machine.stops == (stop,)
        with closing(sqlite3.connect(tmp_path / "sweepid.sqlite")) as beside:
            assert beside.execute("SELECT id FROM stop WHERE reset_at IS NULL").fetchall() == [(stop.id,)]
        released = await http.post("/stop/reset", json={"by": "anna", "stops": [stop.id]})
        assert (released.status_code, released.json()["latched"]) == (200, False)


@pytest.mark.slow
async def test_stop_does_not_wait_for_a_thread_of_the_pool(tmp_path: Path, profile: Path) -> None:
    async with opened(tmp_path, profile) as (application, http):
        go = threading.Event()
        threads = int(anyio.to_thread.current_default_thread_limiter().total_tokens)
        # every thread waits, as readers of a database do that does not answer
        waiting = [asyncio.create_task(anyio.to_thread.run_sync(go.wait)) for _ in range(threads)]
        try:
            held = await asyncio.wait_for(http.post("/stop"), 10)
            assert held.json()["unconfirmed"]
            assert application.machine.latched is not None
        finally:
            go.set()
            await asyncio.gather(*waiting)


@pytest.mark.slow
def test_the_stop_waits_for_no_body(served: str) -> None:
    """A body is announced and never sent."""
    server = httpx.URL(served)
    with socket.create_connection((server.host, server.port), timeout=10) as connection:
        connection.sendall(f"{HEAD.format('/api/v1/stop', 1000)}\r\n{{".encode())
        head, _, content = connection.recv(65536).partition(b"\r\n\r\n")
        assert b" 503 " in head.splitlines()[0]  # there is no machine
        while True:
            try:
                assert json.loads(content)["unconfirmed"]
                break
            except ValueError:
                content += connection.recv(65536)
    with httpx.Client(base_url=f"{served}/api/v1", timeout=60, trust_env=False) as http:
        release_all(http)


# -- the epoch of a request: that of its arrival, or that which the person saw


@pytest.mark.parametrize("origins", [(), ("https://example.org",)])
def test_nothing_comes_before_the_arrival(origins: tuple[str, ...]) -> None:
    assert create_app(Settings(cors_origins=origins)).user_middleware[0].cls is Arrival


@pytest.mark.usefixtures("released")
def test_a_stop_begins_an_epoch_and_its_release_none(http: httpx.Client, url: str) -> None:
    before = epoch(http)
    assert http.get("/drives").json()["epoch"] == epoch(http) == before
    http.post("/stop", params={"by": "berta"})
    stopped = epoch(http)
    assert stopped != before
    with ServiceClient(url) as client:
        told = (event["data"] for event in client.events() if event["kind"] == "stop")
        assert next(data["epoch"] for data in told if data["by"] == "berta" and data["epoch"] != before) == stopped
    (stop,) = http.get("/stop").json()["stops"]
    assert http.post("/stop/reset", json={"by": "anna", "stops": [stop["id"]]}).json()["epoch"] == stopped


@pytest.mark.usefixtures("released")
def test_what_a_person_wanted_who_did_not_see_the_stop_is_refused(http: httpx.Client, planned: int) -> None:
    seen = {EPOCH: epoch(http)}
    http.post("/stop", params={"by": "anna", "why": "smoke"})
    http.post("/stop/reset", json={"by": "anna", "stops": [http.get("/stop").json()["stops"][0]["id"]]})
    plan = http.get(f"/campaigns/{planned}").json()["plan_id"]
    approval = {"sha256": http.get(f"/plans/{plan}/approvals").json()["sha256"], "approved_by": "anna"}
    for path, body in ((f"/campaigns/{planned}/start", {}), (f"/plans/{plan}/approvals", approval)):
        refused = http.post(path, json=body, headers=seen)
        assert (refused.status_code, refused.json()["type"]) == (409, SUPERSEDED)
        assert "stopped by anna: smoke" in refused.json()["detail"]
        assert "give the command again" in refused.json()["detail"]
    assert http.get(f"/plans/{plan}/approvals").json()["items"] == []
    seen = {EPOCH: epoch(http)}
    assert http.post(f"/plans/{plan}/approvals", json=approval, headers=seen).status_code == 201
    assert http.post(f"/campaigns/{planned}/start", json={}, headers=seen).status_code == 503  # no drive answers
    nobodys = http.post(f"/campaigns/{planned}/start", json={}, headers={EPOCH: "of another service"})
    assert (nobodys.status_code, nobodys.json()["type"]) == (409, SUPERSEDED)


@pytest.mark.slow
def test_a_start_whose_body_comes_after_a_stop_is_older_than_the_stop(served: str) -> None:
    server, start = httpx.URL(served), f"/api/v1/campaigns/{add_campaign(served)}/start"
    head = f"{HEAD.format(start, 2)}Expect: 100-continue\r\nConnection: close\r\n\r\n"
    with (
        httpx.Client(base_url=f"{served}/api/v1", timeout=60, trust_env=False) as http,
        socket.create_connection((server.host, server.port), timeout=30) as line,
        line.makefile("rb") as answers,
    ):
        line.sendall(head.encode())
        assert b" 100 " in answers.readline()  # the service waits for the body
        http.post("/stop", params={"by": "anna", "why": "smoke"})
        release_all(http)
        line.sendall(b"{}")
        answer = answers.read()
    assert b" 409 " in answer
    assert SUPERSEDED.encode() in answer
