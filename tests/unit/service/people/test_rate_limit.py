"""Wrong keys are limited by address, and what counts them does not grow."""

import sqlite3
from contextlib import closing
from datetime import timedelta
from pathlib import Path

import httpx
import pytest

from service.store.access.keys import new_key
from service.store.access.permissions import Role
from service.store.database import open_database
from service.store.people.audit import AuditStore
from service.store.people.keys import KeyStore
from service.web.api.access import MOST, WINDOW, Guesses
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
    for number in range(3 * MOST):
        guesses.wrong(f"10.0.{number // 256}.{number % 256}", 0.0)
        guesses.opened(str(number))
    assert len(guesses) == 2 * MOST
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
