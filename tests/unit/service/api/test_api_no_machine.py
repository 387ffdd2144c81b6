"""`sweepid serve --no-machine` beside the service of a machine, on one database: it shows all and changes nothing."""

import re
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from service.process.settings import Settings
from service.web.api.route_roles import API, LOGINS, STOP
from service.web.app import create_app
from tests.unit.service.hosting import hosting

pytestmark = pytest.mark.slow

ALLOWED = {STOP, *LOGINS, ("POST", f"{API}/logout")}
ROLES = create_app(Settings()).state.permissions.roles
CHANGES = sorted(path.removeprefix(API) for method, path in ROLES if method == "POST" and (method, path) not in ALLOWED)
WHY = "this service has no machine (`--no-machine`) and only shows the plant"


@pytest.fixture(scope="module")
def http_of_the_machine(url: str) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=f"{url}{API}", timeout=60, trust_env=False) as client:
        yield client


@pytest.fixture(scope="module")
def beside(url: str, folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A service without a machine on the database of `url`. Its profile does not exist: nobody reads it."""
    assert url
    own = tmp_path_factory.mktemp("no-machine")
    database = f"sqlite:///{folder / 'data' / 'sweepid.sqlite'}"
    with hosting(own, own / "no-profile.yaml", database_url=database, no_machine=True) as address:
        yield address


@pytest.fixture
def reader(beside: str) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=f"{beside}{API}", timeout=60, trust_env=False) as client:
        yield client


def test_it_shows_what_the_machine_has(reader: httpx.Client, campaign: int) -> None:
    shown = reader.get(f"/campaigns/{campaign}").raise_for_status().json()
    assert (shown["machine"], shown["here"], shown["progress"]["total"]) == ("machine", False, 3)
    assert campaign in {one["id"] for one in reader.get("/campaigns", params={"limit": 200}).json()["items"]}
    for path in ("/robots", "/plans", "/diagnoses", "/models", "/fleet", "/me", f"/campaigns/{campaign}/sweeps"):
        assert reader.get(path).status_code == 200, path
    assert reader.get("/audit", params={"newest": True}).json()["items"]


@pytest.mark.parametrize("path", CHANGES)
def test_every_route_that_changes_something_is_refused(reader: httpx.Client, campaign: int, path: str) -> None:
    named = re.sub(r"\{\w+\}", str(campaign), path)
    answer = reader.post(named, json={}, headers={"Idempotency-Key": f"once-{path}"})
    assert (answer.status_code, answer.headers["content-type"]) == (409, "application/problem+json")
    assert answer.json()["type"] == "urn:sweepid:problem:no-machine"
    assert WHY in answer.json()["detail"]


def test_stop_says_that_nothing_was_stopped(reader: httpx.Client, http_of_the_machine: httpx.Client) -> None:
    answer = reader.post("/stop", params={"by": "Ada", "why": "a test"})
    assert answer.status_code == 503
    assert answer.json()["detail"].startswith("nothing was stopped: this service has no machine")
    assert http_of_the_machine.get("/stop").json()["latched"] is False  # nor was anything latched elsewhere
    told = reader.get("/stop").json()
    assert (told["latched"], told["stops"], told["port"]) == (False, [], None)
    assert WHY in told["process_trouble"]


def test_there_are_no_drives_and_it_is_ready_all_the_same(reader: httpx.Client) -> None:
    drives = reader.get("/drives").json()
    assert (drives["connected"], drives["axes"], drives["capabilities"]) == (False, [], None)
    assert WHY in drives["trouble"]
    assert reader.get("/health/ready").json() == {"ready": True, "causes": [], "recordings": None}


def test_metrics_are_those_of_the_plant(beside: str, campaign: int) -> None:
    text = httpx.get(f"{beside}/metrics", timeout=60, trust_env=False).text
    assert campaign
    assert "sweepid_machine_connected" not in text
    assert 'sweepid_machine_stops_held{machine="machine"} 0.0' in text
    assert re.search(r'sweepid_campaigns\{machine="machine",state="\w+"\} [1-9]', text)
    assert text.count("sweepid_machine_stops_held{") == 1  # no machine was added for it


def test_audit_entries_name_the_machine_where_there_is_one(
    reader: httpx.Client, http_of_the_machine: httpx.Client, campaign: int
) -> None:
    reader.post("/drives/connect")
    http_of_the_machine.post(f"/campaigns/{campaign}/pause")  # refused, and told all the same
    entries = [one["entry"] for one in reader.get("/audit", params={"newest": True, "limit": 200}).json()["items"]]
    by_path = {one["path"]: one for one in entries if one["event"] == "outcome"}
    assert by_path[f"{API}/campaigns/{campaign}/pause"]["machine"] == "machine"
    refused = by_path[f"{API}/drives/connect"]
    assert ("machine" in refused, refused["status"]) == (False, 409)
    assert WHY in refused["why"]
