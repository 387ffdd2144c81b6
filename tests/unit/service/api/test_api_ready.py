"""Readiness tells of worker, lease and disk, each in a service whose worker dies, whose database is blocked, whose
disk is too small."""

import asyncio
import os
import signal
import sqlite3
from contextlib import closing
from pathlib import Path

import httpx
import pytest

from tests.unit.service.api.conftest import opened

pytestmark = pytest.mark.slow

PATIENCE = 60.0  # s


async def told(http: httpx.AsyncClient, word: str, *, there: bool = True) -> str:
    """The cause that has `word`, as soon as there is one; or, not `there`, as soon as there is none."""
    async with asyncio.timeout(PATIENCE):
        while True:
            answer = await http.get("/health/ready")
            found = [cause for cause in answer.json()["causes"] if word in cause]
            if bool(found) is there:
                assert answer.status_code == 503  # there is no machine, in any case
                return "".join(found)
            await asyncio.sleep(0.02)


async def test_a_worker_that_ended_is_told_until_it_is_replaced(tmp_path: Path, profile: Path) -> None:
    async with opened(tmp_path, profile) as (application, http):
        assert (await http.head("/health/live")).status_code == 200  # monitors ask so
        assert (await http.head("/health/ready")).status_code == 503
        os.kill((await application.worker.processes())[0], signal.SIGKILL)
        await told(http, "worker process ended")
        await told(http, "worker process", there=False)


async def test_a_lease_that_cannot_be_renewed_is_told(
    tmp_path: Path, profile: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("service.store.engines.sqlite.BUSY_TIMEOUT", 0.05)
    async with opened(tmp_path, profile, lease_time=0.5) as (_, http):
        with closing(sqlite3.connect(tmp_path / "sweepid.sqlite", isolation_level=None)) as other:
            other.execute("BEGIN EXCLUSIVE")
            await told(http, "lease could not be renewed")
            other.execute("ROLLBACK")
        await told(http, "lease could not be renewed", there=False)


async def test_a_disk_that_is_too_full_is_told(tmp_path: Path, profile: Path) -> None:
    async with opened(tmp_path, profile, least_free_disk=2**62) as (_, http):
        assert f"limit {2**62} bytes" in await told(http, "bytes free in")


async def test_a_lost_database_is_told_and_nothing_is_stored_in_its_place(tmp_path: Path, profile: Path) -> None:
    recordings = tmp_path / "recordings" / "campaign-000001"
    recordings.mkdir(parents=True)
    (recordings / "0001-1.parquet").write_bytes(b"samples")
    stream = recordings / "0002-1.arrows"
    stream.write_bytes(b"stream")
    async with opened(tmp_path, profile) as (application, http):
        assert "contains 1 recordings" in await told(http, "has no campaign")
        plan = application.store.add_plan(application.store.robots()[0].id, {})
        answer = await http.post("/campaigns", json={"plan_id": plan.id})
        assert answer.status_code == 409
        assert "restore it from a backup" in answer.json()["detail"]
        assert application.store.campaigns() == ()
    assert stream.read_bytes() == b"stream"
