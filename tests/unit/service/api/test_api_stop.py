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
    assert http.get("/stop").json() == {"latched": False, "stop": None}
    held = http.post("/stop", params={"by": "anna", "why": "smoke"}).json()
    assert held["latched"] is True
    assert (held["stop"]["by"], held["stop"]["why"]) == ("anna", "smoke")
    assert http.get("/stop").json()["latched"] is True
    assert "stopped by anna: smoke" in http.get("/health/ready").json()["causes"]

    again = http.post("/stop", content=b"\xff not json")  # twice, and with nonsense
    assert (again.status_code, again.json()["latched"]) == (200, True)

    for nobody in ({}, {"by": ""}, {"by": "  "}, {"by": "anna", "force": True}):
        assert http.post("/stop/reset", json=nobody).status_code == 422
    assert http.get("/stop").json()["latched"] is True
    reset = http.post("/stop/reset", json={"by": "anna"}).json()
    assert reset["latched"] is False
    assert reset["stop"]["reset_by"] == "anna"
    assert http.post("/stop/reset", json={"by": "anna"}).status_code == 409


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
            assert held.json()["latched"] is True
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
