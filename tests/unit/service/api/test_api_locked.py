"""A release that the database does not take is refused in time, and every stop holds on: a really locked file."""

import sqlite3
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import httpx
import pytest

from service.app import create_app
from service.settings import Settings
from service.store.guards import StopLatch
from tests.system.rest_bench import until
from tests.unit.service.api.conftest import CONFIG, serving

pytestmark = pytest.mark.slow


def lock(data: Path) -> sqlite3.Connection:
    beside = sqlite3.connect(data / "sweepid.sqlite", timeout=30, isolation_level=None, check_same_thread=False)
    beside.execute("BEGIN IMMEDIATE")
    return beside


def test_a_release_while_the_database_is_locked(tmp_path: Path, profile: Path) -> None:
    with serving(tmp_path, profile) as url, httpx.Client(base_url=f"{url}/api/v1", timeout=60, trust_env=False) as http:
        http.post("/stop", params={"by": "anna", "why": "smoke"})
        until(lambda: http.get("/stop").json()["stop"]["id"] > 0, "the database has the stop")
        (stop,) = http.get("/stop").json()["stops"]
        release = {"by": "anna", "stops": [stop["id"]]}
        with closing(lock(tmp_path / "data")):
            refused = http.post("/stop/reset", json=release)  # it is answered while the file is locked
            assert http.get("/stop").json()["stops"] == [stop]
        assert (refused.status_code, refused.headers["retry-after"]) == (503, "5")
        assert refused.headers["content-type"] == "application/problem+json"
        assert refused.json()["type"] == "urn:sweepid:problem:not-audited"  # the first that the locked file keeps away
        assert http.get("/stop").json()["stops"] == [stop]
        until(lambda: http.post("/stop/reset", json=release).status_code == 200, "released once the file is free")
        assert http.get("/stop").json()["latched"] is False


async def test_a_lock_that_comes_after_the_entry_in_the_audit(
    tmp_path: Path, profile: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = Settings(data_dir=tmp_path, drive=profile, robots_dir=CONFIG / "robots", cells_dir=CONFIG / "cells")
    app, reset, locks = create_app(settings), StopLatch.reset, list[sqlite3.Connection]()

    def locked(latch: StopLatch, by: str, stops: Sequence[int]):
        locks.append(lock(tmp_path))
        return reset(latch, by, stops)

    async with app.router.lifespan_context(app):
        transport = httpx.ASGITransport(app=app)
        async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1/api/v1") as http:
            await http.post("/stop", params={"by": "anna"})
            machine = app.state.application.machine
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
