"""A person logs in at an OpenID provider that is not ours (`oidc-provider-mock`), over loopback, without a machine."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import httpx
import pytest

from service.store.access import Role
from service.store.database import Database
from service.store.people.users import UserStore
from tests.command import sweepid
from tests.unit.service.hosting import hosting
from tests.unit.service.people.conftest import Since, calling, stored_in

pytestmark = pytest.mark.slow

WHO = {"actor": "test", "address": "test"}
ROLES = {"cell-operators": "operator", "cell-admins": "admin"}
BEGIN, END = "/api/v1/login/oidc", "/api/v1/login/oidc/code"
PASSWORD = "a horse and a battery"


@pytest.fixture(scope="module")
def issuer() -> Iterator[str]:
    command = [sys.executable, "-W", "ignore", str(Path(__file__).with_name("provider_process.py"))]
    environment = {**os.environ, "AUTHLIB_INSECURE_TRANSPORT": "1"}
    with subprocess.Popen(command, stdout=subprocess.PIPE, env=environment, text=True) as provider:
        try:
            line = provider.stdout.readline() if provider.stdout else ""
            assert line, "the provider did not start"
            yield line.strip()
        finally:
            provider.kill()


def provider_settings(issuer: str, folder: Path) -> dict[str, object]:
    secret = folder / "client.secret"
    secret.write_text("a secret of the client\n", encoding="utf-8")
    return {"issuer": issuer, "client_id": "sweepid", "client_secret_file": str(secret), "roles": ROLES}


@pytest.fixture(scope="module")
def url(folder: Path, profile: Path, issuer: str) -> Iterator[str]:
    with hosting(folder, profile, login=True, wrong_keys=1000, oidc=provider_settings(issuer, folder)) as url:
        yield url


def begin(http: httpx.Client) -> str:
    """The address to which the page sends the browser."""
    begun = http.post(BEGIN, headers={"Origin": str(http.base_url).rstrip("/")})
    assert begun.status_code == 200, begun.text
    return begun.json()["url"]


def at_provider(address: str, sub: str) -> dict[str, str]:
    """What the provider sends the browser back with."""
    answer = httpx.post(address, data={"sub": sub}, timeout=60, trust_env=False)
    assert answer.status_code == 302, answer.text
    return {name: values[0] for name, values in parse_qs(urlsplit(answer.headers["location"]).query).items()}


def hand_in(http: httpx.Client, brought: dict[str, str]) -> httpx.Response:
    return http.post(END, json=brought, headers={"Origin": str(http.base_url).rstrip("/")})


def log_in(http: httpx.Client, sub: str) -> httpx.Response:
    return hand_in(http, at_provider(begin(http), sub))


def test_a_login_from_its_beginning_to_the_logout(
    url: str, issuer: str, database: Database, since: Since, folder: Path
) -> None:
    with calling(url, None) as http:
        assert http.get("/api/v1/login").json() == {"login": True, "oidc": "Log in with the company's account"}
        address = begin(http)
        asked = {name: values[0] for name, values in parse_qs(urlsplit(address).query).items()}
        assert address.startswith(f"{issuer}/oauth2/authorize?")
        assert asked["redirect_uri"] == f"{url}/"
        assert (asked["response_type"], asked["code_challenge_method"]) == ("code", "S256")
        assert min(len(asked[name]) for name in ("state", "nonce", "code_challenge")) >= 43
        brought = at_provider(address, "otto")
        logged_in = hand_in(http, brought)
        assert logged_in.status_code == 200, logged_in.text
        told = {"login": True, "name": "otto", "role": "operator", "session": True}
        assert {name: logged_in.json()[name] for name in told} == told
        assert http.get("/api/v1/me").json() == logged_in.json()  # test_sessions has the rest
        assert http.post("/api/v1/logout", headers={"Origin": url}).status_code == 200
    (otto,) = [user for user in UserStore(database).all() if user.name == "otto"]
    assert (otto.issuer, otto.subject, otto.role) == (issuer, "otto", Role.OPERATOR)
    entries = since()
    assert [(one["event"], one["actor"]) for one in entries[:2]] == [("user added", "anybody"), ("logged in", "otto")]
    assert (entries[1]["issuer"], entries[1]["subject"]) == (issuer, "otto")
    kept = stored_in(folder)
    for secret in (brought["code"], brought["state"], "a secret of the client"):
        assert secret.encode() not in kept


def test_the_highest_role_of_the_groups_holds(url: str) -> None:
    with calling(url, None) as http:
        assert log_in(http, "adam").json()["role"] == "admin"
        assert log_in(http, "one").json()["role"] == "operator"


@pytest.mark.parametrize("sub", ["nobody", "nogroups"])
def test_who_has_no_role_is_refused_in_one_sentence(
    url: str, sub: str, issuer: str, database: Database, since: Since
) -> None:
    with calling(url, None) as http:
        refused = log_in(http, sub)
        assert (refused.status_code, refused.json()["detail"]) == (
            403,
            f"no group of {sub} at {issuer} is assigned to a role: ask the administrator of this service",
        )
        assert http.get("/api/v1/me").status_code == 401
    assert sub not in [user.name for user in UserStore(database).all()]
    (outcome,) = [one for one in since() if one["event"] == "outcome" and one["status"] == 403]
    assert (outcome["subject"], outcome["issuer"]) == (sub, issuer)


def test_the_role_is_renewed_with_each_login(url: str, database: Database, issuer: str, since: Since) -> None:
    with calling(url, None) as http:
        log_in(http, "one")
        with database.write() as session:
            session.connection().exec_driver_sql("UPDATE user_account SET role = 'admin' WHERE name = 'one'")
        assert log_in(http, "one").json()["role"] == "operator"
    assert [one["user_role"] for one in since() if one["event"] == "role changed"] == ["operator"]


def test_who_loses_the_role_loses_the_sessions(url: str, database: Database, issuer: str) -> None:
    with calling(url, None) as first, calling(url, None) as second:
        assert log_in(first, "olga").status_code == 200
        with database.write() as session:  # as if the groups of olga were those of nobody from now on
            session.connection().exec_driver_sql("UPDATE user_account SET subject = 'nobody' WHERE name = 'olga'")
        assert log_in(second, "nobody").status_code == 403
        assert first.get("/api/v1/me").json()["detail"] == "the session of olga was ended: log in again"
        with database.write() as session:
            session.connection().exec_driver_sql("UPDATE user_account SET subject = 'olga' WHERE name = 'olga'")


def test_who_is_disabled_here_stays_so_until_enabled(url: str, database: Database, issuer: str) -> None:
    users = UserStore(database)
    with calling(url, None) as http:
        assert log_in(http, "olga").status_code == 200
        users.set_enabled("olga", WHO, enabled=False)
        assert http.get("/api/v1/me").status_code == 401
        refused = log_in(http, "olga")
        assert refused.status_code == 401
        assert refused.json()["detail"].startswith("olga was disabled on ")
        users.set_enabled("olga", WHO)
        assert log_in(http, "olga").status_code == 200


def test_a_name_that_is_somebodys_is_given_to_nobody_else(url: str, database: Database) -> None:
    UserStore(database).add("person-operator", Role.ADMIN, PASSWORD, WHO)
    with calling(url, None) as http:
        me = log_in(http, "twin").json()
        assert me["name"].startswith("person-operator (")
        assert me["role"] == "operator"
        assert log_in(http, "twin").json()["name"] == me["name"]
        assert log_in(http, "odd").json()["name"].startswith("person (")  # `local` is nobody's


@pytest.mark.parametrize(
    ("sub", "reason"),
    [
        ("expired", "expired"),
        ("unsigned", "none"),
        ("audience", "aud"),
        ("azp", "aud"),
        ("issuer", "iss"),
        ("nonce", "nonce"),
        ("shared", "HS256"),
        ("stranger", "signature"),
        ("future", "yet"),
    ],
)
def test_an_id_token_that_does_not_hold_is_refused(
    url: str, sub: str, reason: str, issuer: str, since: Since, database: Database
) -> None:
    with calling(url, None) as http:
        refused = log_in(http, sub)
        assert refused.status_code == 401, refused.text
        assert refused.json()["detail"].startswith(f"the ID token of {issuer} is not valid: ")
        assert reason.lower() in refused.json()["detail"].lower()
        assert http.get("/api/v1/me").status_code == 401
    assert next(one["status"] for one in since() if one["event"] == "outcome") == 401
    assert sub not in [user.name for user in UserStore(database).all()]


def test_a_login_is_ended_once_and_by_who_began_it(url: str) -> None:
    with calling(url, None) as http, calling(url, None) as other:
        brought = at_provider(begin(http), "olga")
        for state in ("another", brought["state"]):  # another state ends the login
            refused = hand_in(http, {**brought, "state": state})
            assert (refused.status_code, refused.json()["detail"]) == (
                401,
                "unknown or expired login state in this browser: start the login again",
            )
        stolen = at_provider(begin(other), "adam")
        begin(http)
        assert hand_in(http, stolen).status_code == 401  # another browser began it
        assert http.get("/api/v1/me").status_code == 401
        refused = hand_in(http, {**at_provider(begin(http), "olga"), "code": stolen["code"]})
        assert (refused.status_code, "'invalid_grant'" in refused.json()["detail"]) == (401, True)  # PKCE
        brought = at_provider(begin(http), "olga")
        assert hand_in(http, brought).status_code == 200
        assert hand_in(http, brought).status_code == 401
        replayed = hand_in(http, {**at_provider(begin(http), "olga"), "code": brought["code"]})
        assert (replayed.status_code, "'invalid_grant'" in replayed.json()["detail"]) == (401, True)


@pytest.mark.parametrize("path", [BEGIN, END])
@pytest.mark.parametrize("origin", [None, "http://evil.example", "null"])
def test_no_page_but_ours_logs_in(url: str, path: str, origin: str | None) -> None:
    with calling(url, None) as http:
        headers = {} if origin is None else {"Origin": origin}
        refused = http.post(path, json={"code": "c", "state": "s"}, headers=headers)
        assert (refused.status_code, refused.json()["type"]) == (403, "urn:sweepid:problem:foreign-request")


def test_no_request_says_where_a_login_leads(url: str) -> None:
    with calling(url, None) as http:
        evil = "https://evil.example/"
        words = {"next": evil, "redirect_uri": evil, "page": evil}
        begun = http.post(BEGIN, params=words, json=words, headers={"Origin": url, "X-Forwarded-Host": "evil.example"})
        assert parse_qs(urlsplit(begun.json()["url"]).query)["redirect_uri"] == [f"{url}/"]
        foreign = http.post(BEGIN, headers={"Origin": "http://evil.example", "Host": "evil.example"})
        assert foreign.status_code == 403
        extra = hand_in(http, {"code": "c", "state": "s", **words})
        assert extra.status_code == 422
        assert "evil" not in extra.text


def test_a_service_whose_provider_is_gone_works_with_passwords(tmp_path: Path, profile: Path) -> None:
    gone = provider_settings("http://127.0.0.1:1", tmp_path)
    with hosting(tmp_path, profile, login=True, oidc=gone) as url, calling(url, None) as http:
        where = ("--data-dir", str(tmp_path / "data"))
        assert not sweepid("people", "add-user", "anna", "--role", "viewer", *where, stdin=f"{PASSWORD}\n").returncode
        refused = http.post(BEGIN, headers={"Origin": url})
        assert refused.status_code == 503
        assert "http://127.0.0.1:1 does not answer correctly" in refused.json()["detail"]
        assert "log in with a password or a key" in refused.json()["detail"]
        assert http.get("/api/v1/login").json()["oidc"]
        entered = http.post("/api/v1/login", json={"name": "anna", "password": PASSWORD})
        assert entered.status_code == 200
        assert http.post("/api/v1/stop").json()["type"] == "urn:sweepid:problem:stop-not-confirmed"


def test_too_many_wrong_codes_are_looked_at_no_more(tmp_path: Path, profile: Path, issuer: str) -> None:
    settings = provider_settings(issuer, tmp_path)
    with hosting(tmp_path, profile, login=True, wrong_keys=3, oidc=settings) as url, calling(url, None) as http:
        answers = [hand_in(http, {"code": "c", "state": "s"}).status_code for _ in range(4)]
        assert answers == [401, 401, 401, 429]


def test_without_a_provider_the_page_knows_of_none(tmp_path: Path, profile: Path) -> None:
    with hosting(tmp_path, profile, login=True) as url, calling(url, None) as http:
        assert http.get("/api/v1/login").json() == {"login": True, "oidc": None}
        refused = http.post(BEGIN, headers={"Origin": url})
        assert refused.status_code == 409
        assert json.loads(refused.text)["detail"] == ("no identity provider is configured: set `oidc`")
