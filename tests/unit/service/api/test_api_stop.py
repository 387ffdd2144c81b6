"""The stop holds until a person resets it by name; health and metrics tell."""

import asyncio
import sqlite3
import threading
from contextlib import closing
from pathlib import Path

import anyio.to_thread
import httpx
import pytest

from service.app import create_app
from service.settings import Settings
from service.store.documents import LARGEST_ID
from tests.system.rest_bench import until
from tests.unit.service.api.conftest import CONFIG


def test_stop_latches_and_a_name_releases(http: httpx.Client) -> None:
    before = http.get("/stop").json()
    assert (before["latched"], before["stop"], before["stops"]) == (False, None, [])
    told = http.post("/stop", params={"by": "anna", "why": "smoke"})
    assert told.status_code == 503  # latched, but there is no machine that could say that it stands
    assert all(reason.startswith("not connected: ") for reason in told.json()["unconfirmed"].values())
    assert set(told.json()["unconfirmed"]) == {f"joint_{number}" for number in range(1, 7)}
    held = http.get("/stop").json()
    assert held["latched"] is True
    assert (held["stop"]["by"], held["stop"]["why"]) == ("anna", "smoke")
    assert "stopped by anna: smoke" in http.get("/health/ready").json()["causes"]

    for way, by in (("/stop", "berta"), ("/stop/", "carl")):  # again, with nonsense; a slash makes no redirection of it
        assert http.post(way, params={"by": by}, content=b"\xff not json").status_code == 503
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
    with closing(sqlite3.connect(folder / "data" / "sweepid.sqlite", timeout=30, isolation_level=None)) as beside:
        beside.execute("BEGIN IMMEDIATE")
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
async def test_stop_does_not_wait_for_a_thread_of_the_pool(tmp_path: Path, profile: Path) -> None:
    settings = Settings(data_dir=tmp_path, drive=profile, robots_dir=CONFIG / "robots", cells_dir=CONFIG / "cells")
    app = create_app(settings)
    async with app.router.lifespan_context(app):
        go = threading.Event()
        threads = int(anyio.to_thread.current_default_thread_limiter().total_tokens)
        # every thread waits, as readers of a database do that does not answer
        waiting = [asyncio.create_task(anyio.to_thread.run_sync(go.wait)) for _ in range(threads)]
        try:
            transport = httpx.ASGITransport(app=app)
            async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1") as http:
                held = await asyncio.wait_for(http.post("/api/v1/stop"), 10)
            assert held.json()["unconfirmed"]
            assert app.state.application.machine.latched is not None
        finally:
            go.set()
            await asyncio.gather(*waiting)


def test_health_tells_why_nothing_can_be_measured(http: httpx.Client) -> None:
    assert http.get("/health/live").json() == {"alive": True}
    ready = http.get("/health/ready")
    assert ready.status_code == 503
    (cause,) = ready.json()["causes"]
    assert "could not be opened" in cause
