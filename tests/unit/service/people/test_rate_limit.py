"""Wrong keys are limited by address, and what counts them does not grow."""

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from datetime import timedelta
from pathlib import Path

import httpx
import pytest

from service.process.settings import Settings
from service.store.access.credentials import new_key
from service.store.access.permissions import Role
from service.store.database import open_database
from service.store.people.audit import AuditStore
from service.store.people.users import KeyStore
from service.web.api.access import WINDOW, Guesses
from tests.unit.service.api.conftest import serving
from tests.unit.service.hosting import hosting
from tests.unit.service.people.conftest import calling

pytestmark = pytest.mark.slow

WRONG = 3
START = "/api/v1/campaigns/987654/start"


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
