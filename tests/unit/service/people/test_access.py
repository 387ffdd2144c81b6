"""Each role against each route of a service that asks who it is; wrong keys are limited by address."""

import re
import sqlite3
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from datetime import timedelta
from pathlib import Path
from typing import Any, cast

import httpx
import pytest
from sqlalchemy import text

from service.process.settings import Settings
from service.store.access import Role, new_key
from service.store.database import Database, open_database
from service.store.people.audit import AuditDocument, AuditStore, AuditUnreadable, verify
from service.store.people.users import KeyStore
from service.web.api.access import WINDOW, Guesses
from service.web.api.route_roles import SOCKET
from service.web.app import create_app
from service.web.client import ServiceClient, ServiceProblem
from tests.unit.service.api.conftest import serving
from tests.unit.service.hosting import hosting, opened
from tests.unit.service.people.conftest import calling, stored_in

pytestmark = pytest.mark.slow
NOBODY_THERE = "987654"  # stands for every number in a path
START = f"/api/v1/campaigns/{NOBODY_THERE}/start"


def status_of(http: httpx.Client, url: str, method: str, path: str, key: str | None) -> int:
    if method == SOCKET:
        return opened(url, path, {} if key is None else {"Authorization": f"Bearer {key}"})
    with http.stream(method, path) as answer:  # events never end
        if answer.status_code in (401, 403):
            assert answer.headers["content-type"] == "application/problem+json"
            assert ("www-authenticate" in answer.headers) == (answer.status_code == 401)
            assert answer.read()
        return answer.status_code


@pytest.mark.parametrize("role", [None, *Role], ids=lambda role: "nobody" if role is None else role.word)
def test_each_route_lets_in_who_may(url: str, keys: dict[str, str], role: Role | None) -> None:
    key = None if role is None else keys[role.word]
    with calling(url, key) as http:
        for (method, template), needed in create_app(Settings()).state.permissions.roles.items():
            status = status_of(http, url, method, re.sub(r"\{\w+\}", NOBODY_THERE, template), key)
            if needed is None or (role is not None and role >= needed):
                assert status not in (401, 403), (method, template)
            else:
                # a WebSocket is refused before it opens, and has no other status for that
                assert status == (401 if role is None and method != SOCKET else 403), (method, template)
        for method in ("GET", "PUT"):  # what is nowhere in the table
            assert http.request(method, "/api/v1/nothing").status_code == (401 if role is None else 404)


def after(database: Database, number: int = 0) -> list[AuditDocument]:
    return list(AuditStore(database).documents(number, 10000))


def entries_so_far(url: str, keys: dict[str, str]) -> int:
    """Of the audit, those of earlier tests' stops too: the service answers when they are written."""
    with calling(url, keys["admin"]) as admin:
        newest = admin.get("/api/v1/audit", params={"newest": True, "limit": 1}).json()["items"]
    return newest[0]["number"] if newest else 0


def test_an_attack_is_refused_and_in_the_audit(
    url: str, keys: dict[str, str], database: Database, folder: Path
) -> None:
    before = entries_so_far(url, keys)
    guesses = [new_key() for _ in range(100)]
    with calling(url, None) as http:
        assert http.post(START).status_code == 401
        for wrong in ("sweepid-", "one two", "x" * 3000, keys["admin"].upper(), keys["admin"] + "0"):
            assert http.post(START, headers={"Authorization": f"Bearer {wrong}"}).status_code == 401
        assert http.post(START, headers={"Authorization": f"Basic {keys['admin']}"}).status_code == 401
        for guess in guesses:
            refused = http.post(START, headers={"Authorization": f"Bearer {guess}"})
            assert (refused.status_code, guess in refused.text) == (401, False)
        # who puts a key where it does not belong does not have it stored
        assert http.post(f"/api/v1/{guesses[0]}").status_code == 401
    entries = [one.entry for one in after(database, before)]
    assert Counter((one["event"], one["actor"], one["address"], one["status"]) for one in entries) == {
        ("outcome", "unknown", "127.0.0.1", 401): 108
    }
    assert {cast(Any, one["route"]) for one in entries} == {"/api/v1/campaigns/{campaign_id}/start", None}
    assert Counter(str(one["why"])[:8] for one in entries) == {"not auth": 3, "this key": 105}
    stored = stored_in(folder)
    assert not [key for key in (*keys.values(), *guesses) if key.removeprefix("sweepid-").encode() in stored]


def test_expired_and_revoked_keys_open_nothing_at_once_and_are_told(
    url: str, keys: dict[str, str], database: Database
) -> None:
    before, store = entries_so_far(url, keys), KeyStore(database)
    for name in ("expired", "revoked"):
        with calling(url, keys[name]) as http:
            refused = http.get("/api/v1/robots")
        assert (refused.status_code, f" {name} on " in refused.json()["detail"]) == (401, True)
    assert [one.entry["actor"] for one in after(database, before)] == ["too-late", "no-more"]
    _, key = store.add("short-lived", Role.VIEWER, timedelta(days=1), {"actor": "test"})
    with calling(url, key) as http:
        assert http.get("/api/v1/robots").status_code == 200
        store.revoke("short-lived", {"actor": "test"})
        assert http.get("/api/v1/robots").status_code == 401


def test_a_key_is_limited_to_its_scopes(url: str, keys: dict[str, str], database: Database) -> None:
    store, day = KeyStore(database), timedelta(days=1)
    made, key = store.add("line-7", Role.OPERATOR, day, {"actor": "test"}, ["read", "measure"])
    assert store.find(key) == made
    assert made.scopes == ("read", "measure")
    before = entries_so_far(url, keys)
    with calling(url, key) as http:
        assert http.get("/api/v1/robots").status_code == 200
        assert http.post(START).status_code == 404
        refused = http.post("/api/v1/stop/reset", json={"by": "line 7", "stops": [1]})
        told = "POST /api/v1/stop/reset requires scope machine; line-7 has the role operator, limited to read, measure"
        assert (refused.status_code, refused.json()["detail"]) == (403, told)
        assert http.get("/metrics").status_code == 403
        me = http.get("/api/v1/me").json()["refused"]
        assert (me["POST /stop/reset"], me["POST /plans"]) == ("scope machine", "engineer")
        assert "POST /campaigns" not in me
        assert http.post("/api/v1/stop").json()["type"] == "urn:sweepid:problem:stop-not-confirmed"
    assert [one.entry["why"] for one in after(database, before) if one.entry.get("status") == 403] == [
        told,
        "GET /metrics requires scope metrics; line-7 has the role operator, limited to read, measure",
    ]


def test_the_client_takes_its_key_from_the_environment(
    url: str, keys: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("SWEEPID_KEY", raising=False)
    with ServiceClient(url) as client, pytest.raises(ServiceProblem, match="not authenticated") as refused:
        client.robots()
    assert refused.value.status == 401
    monkeypatch.setenv("SWEEPID_KEY", keys["viewer"])
    with ServiceClient(url) as client:
        assert client.robots()
        with pytest.raises(ServiceProblem, match="requires operator; the-viewer has the role viewer"):
            client.start(1)


def test_a_change_is_in_the_audit_before_and_after(url: str, keys: dict[str, str], database: Database) -> None:
    before = entries_so_far(url, keys)
    with calling(url, keys["operator"]) as http:
        assert http.post(START).status_code == 404
        assert http.get("/api/v1/robots").status_code == 200  # reading is nobody's business
    request, outcome = (one.entry for one in after(database, before))
    assert (request["event"], request["actor"], request["role"]) == ("request", "the-operator", "operator")
    assert (outcome["status"], outcome["request"]) == (404, before + 1)
    assert NOBODY_THERE in str(outcome["why"])
    with calling(url, keys["admin"]) as http:
        page = http.get("/api/v1/audit", params={"after": before, "limit": 1}).json()
        assert [one["entry"]["actor"] for one in page["items"]] == ["the-operator"]
        assert page["next"] == before + 1
    verify(AuditStore(database).links())


def test_what_cannot_be_audited_is_not_done_but_stops_are(
    url: str, keys: dict[str, str], database: Database, folder: Path
) -> None:
    before = entries_so_far(url, keys)
    beside = sqlite3.connect(folder / "data" / "sweepid.sqlite", timeout=30)
    campaign = {"plan_id": 987654}
    with calling(url, keys["operator"]) as http, calling(url, keys["admin"]) as admin:
        beside.execute("ALTER TABLE audit RENAME TO gone")
        try:
            refused = http.post("/api/v1/campaigns", json=campaign)
            assert (refused.status_code, refused.json()["type"]) == (503, "urn:sweepid:problem:not-audited")
            stopped = http.post("/api/v1/stop", params={"by": "anna", "why": "unaudited"})
            assert stopped.json()["type"] == "urn:sweepid:problem:stop-not-confirmed"
            assert "unaudited" in [stop["why"] for stop in http.get("/api/v1/stop").json()["stops"]]
            unread = admin.get("/api/v1/audit")  # waits until the stop's entry is refused
            assert (unread.status_code, unread.json()["type"]) == (503, "urn:sweepid:problem:audit-unreadable")
            assert "no such table: audit; check it with" in unread.json()["detail"]
        finally:
            beside.execute("ALTER TABLE gone RENAME TO audit")
            beside.close()
        assert http.post("/api/v1/campaigns", json=campaign).status_code == 404
        http.post("/api/v1/stop")
        entries = [one["entry"] for one in admin.get("/api/v1/audit", params={"after": before}).json()["items"]]
    assert [(one["event"], one.get("status")) for one in entries] == [
        ("outcome", 503),  # of the stop that nobody could write down when it came
        ("request", None),
        ("outcome", 404),
        ("outcome", 503),
    ]
    assert [(one["actor"], one["route"]) for one in (entries[0], entries[-1])] == [("the-operator", "/api/v1/stop")] * 2
    assert "happened" in entries[0]


def test_who_stops_and_who_releases_is_in_the_audit(
    url: str, keys: dict[str, str], database: Database, folder: Path
) -> None:
    with calling(url, None) as nobody, calling(url, keys["operator"]) as http, calling(url, keys["revoked"]) as revoked:
        if of_others := [stop["id"] for stop in http.get("/api/v1/stop").json()["stops"]]:
            assert http.post("/api/v1/stop/reset", json={"by": "Berta", "stops": of_others}).status_code == 200
        before = entries_so_far(url, keys)
        for one, by in ((nobody, "anna"), (http, ""), (revoked, "gone"), (http, keys["admin"])):
            assert one.post("/api/v1/stop", params={"by": by, "why": "smoke"}).status_code == 503
        held = http.get("/api/v1/stop").json()["stops"]
        stops = [stop["id"] for stop in held]
        smoke = [stop["by"] for stop in held if stop["why"] == "smoke"]
        assert Counter(smoke) == Counter(["anna", "127.0.0.1", "gone", "sweepid-(key)"])
        assert http.post("/api/v1/stop/reset", json={"by": "Berta", "stops": stops}).status_code == 200
    assert keys["admin"].removeprefix("sweepid-").encode() not in stored_in(folder)
    with calling(url, keys["admin"]) as admin:
        items = admin.get("/api/v1/audit", params={"after": before}).json()["items"]
    outcomes = [one["entry"] for one in items if one["entry"]["event"] == "outcome"]
    assert [(one["actor"], one["role"], one["address"], one["by"]) for one in outcomes] == [
        ("anybody", None, "127.0.0.1", "anna"),
        ("the-operator", "operator", "127.0.0.1", "127.0.0.1"),
        ("anybody", None, "127.0.0.1", "gone"),  # a key that is no more names nobody
        ("the-operator", "operator", "127.0.0.1", "sweepid-(key)"),
        ("the-operator", "operator", "127.0.0.1", "Berta"),
    ]
    assert [one["reason"] for one in outcomes[:4]] == ["smoke"] * 4
    assert outcomes[4]["stops"] == stops


def test_an_entry_that_is_no_json_is_a_problem(tmp_path: Path) -> None:
    with open_database(f"sqlite:///{tmp_path / 'sweepid.sqlite'}") as own:
        store = AuditStore(own)
        store.append([{"event": "request"}])
        with own.write() as session:
            session.execute(text("INSERT INTO audit VALUES (2, '[1]', 'abc')"))
        with pytest.raises(AuditUnreadable, match="audit entry 2 is not a JSON object"):
            store.documents()


def test_a_change_that_waits_for_the_audit_holds_up_nobody(url: str, keys: dict[str, str], folder: Path) -> None:
    beside = sqlite3.connect(folder / "data" / "sweepid.sqlite", timeout=30, isolation_level=None)
    with calling(url, keys["operator"]) as http, ThreadPoolExecutor(1) as other, calling(url, None) as nobody:
        beside.execute("BEGIN IMMEDIATE")
        try:
            waiting = other.submit(http.post, START)
            assert nobody.get("/api/v1/health/live").status_code == 200
            assert not waiting.done()
        finally:
            beside.execute("ROLLBACK")
            beside.close()
        assert waiting.result(30).status_code == 404


WRONG = 3


def test_the_minute_slides() -> None:
    guesses = Guesses(WRONG)
    for second in (0.0, 10.0, 20.0):
        assert guesses.wait("10.0.0.1", None, second) == 0
        guesses.wrong("10.0.0.1", second)
    assert guesses.wait("10.0.0.1", None, 20.0) == WINDOW - 20.0
    assert guesses.wait("10.0.0.2", None, 20.0) == 0
    assert [guesses.first_refusal("10.0.0.1") for _ in range(3)] == [True, False, False]
    assert guesses.wait("10.0.0.1", None, WINDOW) == 0
    guesses.wrong("10.0.0.1", WINDOW)
    assert guesses.wait("10.0.0.1", None, WINDOW) == 10.0  # until the second one is a minute old
    assert guesses.first_refusal("10.0.0.1")


def test_who_has_opened_is_not_locked_out() -> None:
    guesses = Guesses(1)
    guesses.opened("abc")
    guesses.wrong("10.0.0.1", 0.0)
    assert guesses.wait("10.0.0.1", "abc", 0.0) == 0
    assert guesses.wait("10.0.0.1", "def", 0.0) == WINDOW


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        ("2001:db8::1", "2001:db8::2", True),  # of one network, whose owner chooses the rest
        ("2001:db8::1", "2001:db8:0:1::1", False),
        ("::ffff:10.0.0.1", "10.0.0.1", True),
        ("10.0.0.1", "10.0.0.2", False),
        ("unknown", "unknown", True),
    ],
)
def test_what_is_one_address(one: str, other: str, same: bool) -> None:
    guesses = Guesses(1)
    guesses.wrong(one, 0.0)
    assert (guesses.wait(other, None, 0.0) > 0) == same


def test_the_tables_are_bounded() -> None:
    guesses = Guesses(1)
    for number in range(3 * Guesses.most):
        guesses.wrong(f"10.0.{number // 256}.{number % 256}", 0.0)
        guesses.opened(str(number))
    assert len(guesses) == 2 * Guesses.most
    assert guesses.wait("10.0.0.0", None, 0.0) == 0  # the oldest is forgotten
    assert guesses.wait("10.0.11.183", None, 0.0) == WINDOW  # the newest is not


@pytest.mark.slow
def test_who_guesses_is_refused_and_told_once(tmp_path: Path, profile: Path) -> None:
    with (
        hosting(tmp_path, profile, login=True, wrong_keys=WRONG) as url,
        open_database(f"sqlite:///{tmp_path / 'data' / 'sweepid.sqlite'}") as database,
    ):
        store, day = KeyStore(database), timedelta(days=1)
        at_work, fresh = (store.add(name, Role.OPERATOR, day, {"actor": "test"})[1] for name in ("anna", "berta"))
        before = len(AuditStore(database).documents(0, 100))
        with calling(url, None, "127.0.0.2") as guesser, calling(url, fresh, "127.0.0.3") as elsewhere:
            assert get(guesser, at_work).status_code == 200
            assert [get(guesser, new_key()).status_code for _ in range(WRONG)] == [401] * WRONG
            for key in (new_key(), "no key", fresh):  # the right one is not looked at either
                refused = get(guesser, key)
                assert (refused.status_code, refused.json()["type"]) == (429, "urn:sweepid:problem:too-many-wrong-keys")
                assert 0 < int(refused.headers["retry-after"]) <= WINDOW
            assert guesser.post(START, headers={"Authorization": f"Bearer {new_key()}"}).status_code == 429
            assert guesser.get("/api/v1/robots").status_code == 401  # no key is no guess
            assert get(guesser, at_work).status_code == 200
            assert elsewhere.get("/api/v1/robots").status_code == 200
            stopped = guesser.post("/api/v1/stop", headers={"Authorization": f"Bearer {new_key()}"})
            assert stopped.json()["type"] == "urn:sweepid:problem:stop-not-confirmed"  # there is no machine
        entries = [one.entry for one in AuditStore(database).documents(before, 100)]
    others = [one for one in entries if one["event"] == "outcome" and one["route"] != "/api/v1/stop"]
    told = [(one["address"], one["status"]) for one in others]
    assert told == [("127.0.0.2", 401)] * WRONG + [("127.0.0.2", 429), ("127.0.0.2", 401)]
    assert "too many wrong keys from 127.0.0.2 within 60 s" in str([one.get("why") for one in entries])
    with closing(sqlite3.connect(tmp_path / "data" / "sweepid.sqlite")) as database:
        assert database.execute("SELECT count(*) FROM audit WHERE entry LIKE '%987654%'").fetchone() == (0,)


def get(http: httpx.Client, key: str) -> httpx.Response:
    return http.get("/api/v1/robots", headers={"Authorization": f"Bearer {key}"})


CLAIMED, HERE, PROXY = "203.0.113.9", "127.0.0.1", "127.0.0.2"


BEHIND: dict[str, dict[str, object]] = {
    "no": {"trusted_proxies": [PROXY]},  # without `behind_proxy` the list means nothing
    "yes": {"behind_proxy": True, "trusted_proxies": [f"{PROXY}/32", "10.0.0.0/8"]},
}


@pytest.fixture(scope="module", params=BEHIND)
def service(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, profile: Path) -> Iterator[str]:
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("FORWARDED_ALLOW_IPS", "*")  # which uvicorn reads where nobody tells it
        with serving(tmp_path_factory.mktemp("proxy"), profile, **BEHIND[request.param]) as url:
            yield url


def test_only_a_trusted_proxy_tells_who_asks(service: str, request: pytest.FixtureRequest) -> None:
    for caller in (HERE, PROXY):
        with calling(service, None, caller) as http:
            answer = http.post("/api/v1/campaigns", json={"plan_id": 5}, headers={"X-Forwarded-For": CLAIMED})
            assert answer.status_code == 404
            newest = http.get("/api/v1/audit", params={"newest": True, "limit": 2}).json()["items"]
        trusted = caller == PROXY and "[yes]" in request.node.name
        assert [one["entry"]["address"] for one in newest] == [CLAIMED if trusted else caller] * 2


def test_by_default_the_proxy_is_on_this_computer() -> None:
    assert {str(network) for network in Settings(behind_proxy=True).trusted_proxies} == {f"{HERE}/32", "::1/128"}
