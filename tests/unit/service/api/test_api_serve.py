"""Starting where it cannot start; readiness tells of worker, lease and disk; what Prometheus gets."""

import asyncio
import json
import os
import re
import signal
import socket
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import httpx
import pytest
from prometheus_client.parser import text_string_to_metric_families

from service.store.files.recordings import RecordingFiles
from service.web.api.metrics import GROUPS, page
from service.web.client import ServiceClient
from tests.command import console
from tests.unit.service.api.conftest import opened
from tests.unit.service.hosting import hosting, settings_of

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def taken() -> Iterator[int]:
    """A port."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server.getsockname()[1]


def no_database(folder: Path) -> dict[str, Any]:
    (folder / "data").mkdir()
    (folder / "data" / "sweepid.sqlite").write_bytes(b"no database at all" * 1000)
    return {}


CASES: dict[str, tuple[Callable[[Path], dict[str, Any]], int, tuple[str, ...]]] = {
    "no profile": (lambda _: {"drive": "no-such-profile.yaml"}, 2, ("no-such-profile.yaml",)),
    "no login": (lambda _: {"host": "0.0.0.0"}, 2, ("sweepid: host: '0.0.0.0' is reachable from other computers",)),
    "no database": (no_database, 1, ("sweepid: the service did not start: DatabaseError: ", "file is not a database")),
    "no plant": (lambda _: {"no_machine": True}, 2, ("first start a service of this version that owns a machine",)),
    "port taken": (lambda _: {"port": "TAKEN"}, 1, ("127.0.0.1:TAKEN",)),
    "stop port taken": (lambda _: {"stop_port": "TAKEN"}, 1, ("127.0.0.1:TAKEN",)),
}


@pytest.mark.parametrize("case", CASES)
def test_it_says_in_one_line_why_it_cannot_start(tmp_path: Path, profile: Path, taken: int, case: str) -> None:
    make, code, words = CASES[case]
    before = make(tmp_path)
    given = json.dumps(settings_of(tmp_path, profile, port=0, stop_port=0) | before).replace('"TAKEN"', str(taken))
    (tmp_path / "service.yaml").write_text(given, "utf-8")
    refused = console("serve", "--config", str(tmp_path / "service.yaml"))
    assert (refused.returncode, refused.stdout) == (code, "")
    *log, line = refused.stderr.splitlines()
    assert log == [] or case == "no database"
    for word in words:
        assert word.replace("TAKEN", str(taken)) in line
    assert not (tmp_path / "data").exists() or case != "no login"


def test_what_killed_transfers_left_is_cleared_at_the_start(tmp_path: Path, profile: Path) -> None:
    transfer = RecordingFiles(tmp_path / "data").transfer()
    for name in ("import-x7_a2b3c", "export-0123abcd"):
        (transfer / name / "bundle").mkdir(parents=True)
        (transfer / name / "bundle" / "0001.parquet").write_bytes(bytes(1000))
    with hosting(tmp_path, profile) as url:
        assert list(transfer.iterdir()) == []
        assert httpx.get(f"{url}/api/v1/campaigns", trust_env=False).json()["items"] == []


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
    monkeypatch.setattr("service.store.database.BUSY_TIMEOUT", 0.05)
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


Samples = dict[tuple[str, frozenset[tuple[str, str]]], float]
FIGURES = {figure.name: figure for figures in GROUPS.values() for figure in figures}
STREAMED = {"sweepid_set_points", "sweepid_set_points_missed", "sweepid_set_point_lateness_seconds"}
MOVED = {name for name, figure in FIGURES.items() if figure.absent}  # not in this installation


def scraped(text: str) -> Samples:
    return {
        (sample.name, frozenset(sample.labels.items())): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


def of(samples: Samples, name: str, **labels: str) -> float:
    return samples[name, frozenset(labels.items())]


def test_the_figures_are_those_of_the_latest_estimate(url: str, campaign: int) -> None:
    with ServiceClient(url) as client:
        estimate = client.estimate(campaign)
    samples = scraped(httpx.get(f"{url}/metrics", timeout=30, trust_env=False).text)
    axis = estimate["document"]["axes"]["joint_1"]
    robot = "max100-class"
    assert of(samples, "sweepid_estimate_sweeps", robot=robot, axis="joint_1") == len(axis["inertia"]) == 3
    gap, left = (axis["rmse_percent"][name] / 100 for name in ("reference_measured", "identified_measured"))
    assert of(samples, "sweepid_estimate_gap_ratio", robot=robot, axis="joint_1") == pytest.approx(gap)
    assert of(samples, "sweepid_estimate_left_ratio", robot=robot, axis="joint_1") == pytest.approx(left)
    assert of(samples, "sweepid_estimate_revision", robot=robot) == estimate["revision"]
    assert of(samples, "sweepid_recordings", state="complete") >= 3
    assert of(samples, "sweepid_recorded_samples", state="complete") >= 3 * 1250
    own = {"machine": "machine"}
    assert of(samples, "sweepid_machine_connected", **own) == of(samples, "sweepid_machine_may_move", **own) == 0
    assert of(samples, "sweepid_campaigns", machine="machine", state="completed") >= 1


@pytest.mark.usefixtures("campaign")
def test_every_figure_has_its_help_and_no_other_comes(url: str) -> None:
    text = httpx.get(f"{url}/metrics", timeout=30, trust_env=False).text
    shown = {family.name: family.documentation for family in text_string_to_metric_families(text)}
    assert shown == {name: figure.help for name, figure in FIGURES.items() if name not in STREAMED | MOVED}


def test_names_are_those_that_prometheus_asks_for() -> None:
    assert [name for name in FIGURES if not re.fullmatch(r"sweepid_[a-z_]+[a-z]", name)] == []
    assert [name for name in FIGURES if name.endswith(("_total", "_percent", "_ms", "_min"))] == []


async def test_a_database_that_refuses_takes_only_its_own_figures_away(tmp_path: Path, profile: Path) -> None:
    async with opened(tmp_path, profile) as (_, http):
        with closing(sqlite3.connect(tmp_path / "sweepid.sqlite", timeout=30)) as other:
            other.execute("ALTER TABLE recording RENAME TO elsewhere")
            answer = await http.get("http://127.0.0.1/metrics")
            other.execute("ALTER TABLE elsewhere RENAME TO recording")
    samples = scraped(answer.raise_for_status().text)
    assert of(samples, "sweepid_stop_latched", machine="machine") == 0
    assert of(samples, "sweepid_jobs_open", machine="machine", kind="identification") == 0
    assert "sweepid_estimate_revision" not in {name for name, _ in samples}


def test_the_page_is_fresh(root: Path) -> None:
    told = "run: python -m service.web.api.metrics > docs/reference/metrics.md"
    assert (root / "docs" / "reference" / "metrics.md").read_text("utf-8") == page(), told
