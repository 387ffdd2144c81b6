"""The stop holds until a person resets it by name; health and metrics tell."""

import asyncio
import threading
from pathlib import Path

import anyio.to_thread
import httpx

from service.app import create_app
from service.settings import Settings
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

    for way in ("/stop", "/stop/"):  # again, with nonsense; a slash makes no redirection of it
        assert http.post(way, content=b"\xff not json").status_code == 503
    anna, second, third = (stop["id"] for stop in http.get("/stop").json()["stops"])

    wrong = [{"by": "anna"}, {"by": "anna", "stops": []}, {"by": "anna", "stops": [anna], "force": True}]
    for nobody in (*wrong, *({**name, "stops": [anna]} for name in ({}, {"by": ""}, {"by": "  "}))):
        assert http.post("/stop/reset", json=nobody).status_code == 422
    key = {"Idempotency-Key": "the same again"}
    for _ in range(2):
        reset = http.post("/stop/reset", json={"by": "anna", "stops": [anna]}, headers=key).json()
        assert reset["stop"]["reset_by"] == "anna"
        assert [stop["id"] for stop in reset["stops"]] == [second, third]  # those of others hold
    assert http.post("/stop/reset", json={"by": "anna", "stops": [third + 1]}).status_code == 404
    reset = http.post("/stop/reset", json={"by": "anna", "stops": [second, third]}).json()
    assert (reset["latched"], reset["stops"]) == (False, [])


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
            assert app.state.lab.machine.latched is not None
        finally:
            go.set()
            await asyncio.gather(*waiting)


def test_health_tells_why_nothing_can_be_measured(http: httpx.Client) -> None:
    assert http.get("/health/live").json() == {"alive": True}
    ready = http.get("/health/ready")
    assert ready.status_code == 503
    (cause,) = ready.json()["causes"]
    assert "could not be opened" in cause


def test_metrics(url: str) -> None:
    with httpx.Client(base_url=url, trust_env=False) as http:
        lines = http.get("/metrics").text.splitlines()
    assert "sweepid_machine_connected 0.0" in lines
    assert "sweepid_stop_latched 0.0" in lines
    assert "sweepid_campaign_running 0.0" in lines
