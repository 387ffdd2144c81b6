"""A person has a password, logs in with it, has a session in a cookie, and loses it: without a machine."""

import json
import os
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from time import process_time

import httpx
import pytest
from argon2 import PasswordHasher
from sqlalchemy import select, text

from service import BadInput, Conflict, NotFound
from service.cli.commands.people import revoke_session, sessions
from service.store import tables as t
from service.store.access import Role
from service.store.database import Database, SteadyClock, open_database
from service.store.people.audit import AuditStore
from service.store.people.users import (
    LEAST,
    KeyStore,
    SessionStore,
    UserDocument,
    UserStore,
    begin_time,
    fits,
    keep_time,
    outdated,
    password_hash,
)
from tests.command import SWEEPID, sweepid
from tests.unit.service.hosting import hosting
from tests.unit.service.people.conftest import Since, calling, stored_in

pytestmark = pytest.mark.slow
WHO = {"actor": "test", "address": "test"}
PASSWORD = "a horse and a battery"
WRONG = "not the horse of anna"
START = "/api/v1/campaigns/987654/start"
LONGEST = 24 * 3600.0


@pytest.fixture(scope="module")
def users(database: Database) -> UserStore:
    store = UserStore(database)
    for role in Role:
        store.add(f"person-{role.word}", role, PASSWORD, WHO)
    return store


@pytest.fixture
def person(users: UserStore, request: pytest.FixtureRequest) -> str:
    """An operator of this test's own."""
    return users.add(f"op {request.node.name}"[:100], Role.OPERATOR, PASSWORD, WHO).name


def log_in(http: httpx.Client, name: str, password: str = PASSWORD) -> httpx.Response:
    return http.post("/api/v1/login", json={"name": name, "password": password})


def test_a_session_from_login_to_logout(url: str, person: str, since: Since, folder: Path) -> None:
    with calling(url, None) as http:
        assert http.get("/api/v1/me").status_code == 401
        logged_in = log_in(http, person)
        assert logged_in.status_code == 200, logged_in.text
        told = {"login": True, "name": person, "role": "operator", "session": True}
        assert {name: logged_in.json()[name] for name in told} == told
        (cookie,) = http.cookies.jar
        assert cookie.name == f"sweepid-{httpx.URL(url).port}"
        assert logged_in.headers["set-cookie"].partition(";")[2].lower().replace(" ", "").split(";") == [
            "httponly",
            f"max-age={int(LONGEST)}",
            "path=/",
            "samesite=strict",
        ]
        assert http.get("/api/v1/me").json() == logged_in.json()
        assert http.post(START, headers={"Origin": url}).status_code == 404
        assert http.post("/api/v1/logout", headers={"Origin": url}).status_code == 200
        assert not list(http.cookies.jar)
        http.cookies.set(cookie.name, str(cookie.value))  # who kept it
        refused = http.get("/api/v1/me")
        assert (refused.status_code, refused.json()["detail"]) == (
            401,
            f"the session of {person} was ended: log in again",
        )
    entries = since()
    assert [(one["event"], one["actor"], one.get("status")) for one in entries[1:]] == [
        ("logged in", person, None),
        ("request", person, None),
        ("outcome", person, 404),
        ("request", person, None),
        ("session ended", person, None),
        ("outcome", person, 200),
        ("outcome", person, 401),
    ]
    stored = stored_in(folder)
    assert str(cookie.value).removeprefix("sweepid-").encode() not in stored
    assert PASSWORD.encode() not in stored


@pytest.mark.parametrize("origin", [None, "http://evil.example", "null", "http://127.0.0.1:1"])
def test_a_change_with_a_session_must_come_from_our_page(url: str, person: str, origin: str | None) -> None:
    headers = {} if origin is None else {"Origin": origin}
    with calling(url, None) as http:
        log_in(http, person)
        refused = http.post(START, headers=headers)
        assert (refused.status_code, refused.json()["type"]) == (403, "urn:sweepid:problem:foreign-request")
        stopped = http.post("/api/v1/stop", headers=headers)  # refused to no page; and there is no machine
        assert stopped.json()["type"] == "urn:sweepid:problem:stop-not-confirmed"


def test_a_session_may_what_the_person_may_now_and_its_stop_bears_the_name(
    url: str, person: str, database: Database, since: Since
) -> None:
    with calling(url, None) as http:
        log_in(http, person)
        assert http.get("/api/v1/audit").status_code == 403
        with database.write() as session:
            session.execute(text("UPDATE user_account SET role = 'admin' WHERE name = :name"), {"name": person})
        http.post("/api/v1/stop", headers={"Origin": url})
        assert http.get("/api/v1/audit").status_code == 200  # waits until it is written
    assert [one["actor"] for one in since() if one["route"] == "/api/v1/stop"] == [person]


def test_a_key_stands_above_a_session(url: str, person: str, keys: dict[str, str]) -> None:
    with calling(url, keys["viewer"]) as http:
        log_in(http, person)
        assert http.get("/api/v1/me").json()["name"] == "the-viewer"
        refused = http.post("/api/v1/logout")
        assert (refused.status_code, "revoke-key" in refused.text) == (409, True)


def test_who_is_disabled_or_gets_another_password_is_out(url: str, person: str, users: UserStore) -> None:
    with calling(url, None) as http:
        log_in(http, person)
        users.change_password(person, WRONG, WHO)
        assert "was ended" in http.get("/api/v1/me").json()["detail"]
        assert log_in(http, person, WRONG).status_code == 200
        assert http.get("/api/v1/me").status_code == 200
        users.set_enabled(person, WHO, enabled=False)
        assert f"{person} was disabled on" in http.get("/api/v1/me").json()["detail"]
        assert log_in(http, person, WRONG).json()["detail"] == "name or password is wrong"


def test_sessions_are_told_and_revoked(url: str, person: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with calling(url, None) as http:
        log_in(http, person)
        sessions(data_dir=folder / "data")
        (line,) = [line for line in capsys.readouterr().out.splitlines() if person in line]
        told = httpx.Response(200, text=line).json()
        assert (told["role"], told["address"]) == ("operator", "127.0.0.1")
        revoke_session(told["id"], data_dir=folder / "data")
        assert http.get("/api/v1/me").status_code == 401
        sessions(data_dir=folder / "data")
        assert person not in capsys.readouterr().out


def test_an_unknown_name_has_the_same_answer_after_the_same_time(url: str, person: str) -> None:
    """Processor time of the service, in this process: a hash is some 50 times a look, and of the lowest priority."""
    seconds: dict[str, list[float]] = {person: [], "nobody here": []}
    answers: set[str] = set()
    with calling(url, None) as http:
        for _ in range(7):
            for name, taken in seconds.items():
                began = process_time()
                refused = log_in(http, name, WRONG)
                taken.append(process_time() - began)
                answers.add(refused.text)
                assert refused.status_code == 401
    assert len(answers) == 1
    known, unknown = (min(taken) for taken in seconds.values())
    assert 0.5 < known / unknown < 2


@pytest.mark.parametrize(
    "body",
    [
        {"name": PASSWORD, "pasword": PASSWORD},
        {"name": [PASSWORD], "password": 5},
        {"name": PASSWORD * 10, "password": PASSWORD},
        PASSWORD,
        {"name": "anna", "password": [PASSWORD]},
    ],
)
def test_a_password_in_the_wrong_place_is_told_nowhere(url: str, body: object, since: Since) -> None:
    with calling(url, None) as http:
        refused = http.post("/api/v1/login", json=body)
    assert refused.status_code == 422
    assert PASSWORD not in refused.text
    assert PASSWORD not in str(since())


def test_who_guesses_passwords_is_refused_by_address_and_by_name(tmp_path: Path, profile: Path) -> None:
    with (
        hosting(tmp_path, profile, login=True, wrong_keys=3) as url,
        open_database(f"sqlite:///{tmp_path / 'data' / 'sweepid.sqlite'}") as database,
        calling(url, None, "127.0.0.2") as guesser,
        calling(url, None, "127.0.0.3") as other,
        calling(url, None, "127.0.0.4") as at_home,
    ):
        store = UserStore(database)
        for name in ("anna", "berta"):
            store.add(name, Role.OPERATOR, PASSWORD, WHO)
        before = len(AuditStore(database).documents())
        assert log_in(at_home, "anna").status_code == 200
        assert [log_in(guesser, name, WRONG).status_code for name in ("anna", "no such", "anna")] == [401] * 3
        for name in ("anna", "berta"):
            refused = log_in(guesser, name)
            assert (refused.status_code, refused.json()["type"]) == (429, "urn:sweepid:problem:too-many-wrong-keys")
            assert 0 < int(refused.headers["retry-after"]) <= 60
        assert log_in(other, "anna", WRONG).status_code == 401
        assert "wrong passwords for this name" in log_in(other, "anna").json()["detail"]
        assert log_in(other, "berta").status_code == 200
        assert log_in(at_home, "anna").status_code == 200  # who was here before is not locked out
        entries = [one.entry for one in AuditStore(database).documents(before)]
    assert [(one["event"], one["actor"], one.get("status")) for one in entries] == [
        ("logged in", "anna", None),
        ("outcome", "anna", 401),
        ("outcome", "anybody", 401),
        ("outcome", "anna", 401),
        ("outcome", "anybody", 429),  # and the next one is not told
        ("outcome", "anna", 401),
        ("outcome", "anybody", 429),
        ("logged in", "berta", None),
        ("logged in", "anna", None),
    ]


def test_many_passwords_at_once_hold_up_nobody(url: str, keys: dict[str, str]) -> None:
    """40 at once, of which few wait; meanwhile the service answers others."""
    with ThreadPoolExecutor(40) as crowd, calling(url, None) as http, calling(url, keys["viewer"]) as viewer:

        def attempt(_: int) -> int:
            with calling(url, None) as one:
                return log_in(one, "nobody", WRONG).status_code

        attempts = [crowd.submit(attempt, number) for number in range(40)]
        assert http.get("/api/v1/health/live").status_code == 200
        assert viewer.get("/api/v1/robots").status_code == 200
        statuses = [one.result(120) for one in attempts]
    assert set(statuses) <= {401, 429}
    assert statuses.count(401) >= 1
    assert statuses.count(429) >= 1


def test_who_cannot_be_audited_is_not_logged_in(url: str, person: str, folder: Path) -> None:
    with closing(sqlite3.connect(folder / "data" / "sweepid.sqlite", timeout=30)) as beside, calling(url, None) as http:
        beside.execute("ALTER TABLE audit RENAME TO gone")
        try:
            assert log_in(http, person).status_code >= 500
        finally:
            beside.execute("ALTER TABLE gone RENAME TO audit")
        assert not list(http.cookies.jar)
        assert beside.execute(
            "SELECT count(*) FROM user_session JOIN user_account u ON u.id = user_id WHERE u.name = ?", (person,)
        ).fetchone() == (0,)


HOUR, DAY, SECOND = timedelta(hours=1), timedelta(days=1), timedelta(seconds=1)
MONTH = 30 * DAY


@dataclass
class Computer:
    """A computer whose clock can be set while its monotonic clock runs on."""

    folder: Path
    wall: datetime = datetime(2026, 3, 1, tzinfo=UTC)
    running: float = 0.0
    began: list[Database] = field(default_factory=list)

    def passes(self, time: timedelta) -> None:
        self.wall += time
        self.running += time.total_seconds()

    def set(self, by: timedelta) -> None:
        self.wall += by

    @contextmanager
    def service(self) -> Iterator[tuple[SessionStore, KeyStore, UserDocument]]:
        """A service from its start to its end, or until it is killed: nothing is stored at the end."""
        clock = SteadyClock(lambda: self.wall, lambda: self.running)
        with open_database(f"sqlite:///{self.folder / 'sweepid.sqlite'}", clock=clock) as database:
            begin_time(database)
            self.began.append(database)
            users = UserStore(database)
            user = next(iter(users.all()), None) or users.add("anna", Role.OPERATOR, "a horse and a battery", WHO)
            yield SessionStore(database, idle=8 * 3600, longest=DAY.total_seconds()), KeyStore(database), user

    def minute(self) -> None:
        """What a running service does each minute."""
        keep_time(self.began[-1])


@pytest.fixture
def computer(tmp_path: Path) -> Computer:
    return Computer(tmp_path)


def valid(store: SessionStore | KeyStore, secret: str) -> bool:
    found = store.find(secret)
    assert found is not None
    return not found.trouble(store.now())


Step = str | tuple[str, timedelta]
BOTH, NONE, KEY_ALONE = "both", "none", "the key alone"  # of session and key are valid
RESTART = ("end", "start")
CASES: dict[str, list[Step]] = {
    "a session that is used lasts a day": [
        "log in",
        *(step for _ in range(3) for step in (("pass", 8 * HOUR - SECOND), BOTH)),
        *(("pass", 3 * SECOND), NONE, "told why", ("pass", DAY), "log in again", "forgotten"),
    ],
    "an idle session lasts 8 hours": ["log in", ("pass", 8 * HOUR), KEY_ALONE, "told why"],
    "what has expired does not revive when the clock is set back": [
        *("log in", BOTH, ("pass", 25 * HOUR), NONE, ("set", -20 * HOUR), NONE, "minute", *RESTART, NONE)
    ],
    "a clock that is set back extends nothing": [
        *("log in", ("set", -MONTH)),
        *(step for _ in range(23) for step in (("pass", HOUR), BOTH)),
        *(("pass", 2 * HOUR), NONE),
    ],
    "a login while the clock stood ahead keeps its limit": [
        *(("set", MONTH), "log in", ("set", -MONTH), ("pass", HOUR), BOTH, ("pass", 24 * HOUR), NONE)
    ],
    "a restart after the clock was set back ends the session": [
        *(("set", MONTH), "log in", "end", ("set", -MONTH), "start", KEY_ALONE, "told", ("pass", 25 * HOUR), NONE),
        *("log in again", "again"),  # a person can, meanwhile
    ],
    "what was expired when the service was killed stays so": [
        *("log in", ("pass", 9 * HOUR), "minute", "end", ("set", -4 * HOUR), "start", KEY_ALONE)
    ],
    "a small correction ends nothing": [
        *("log in", "end", ("set", timedelta(seconds=-30)), "start", BOTH, "end", ("pass", HOUR), "start", BOTH)
    ],
}


@pytest.mark.parametrize("case", CASES)
def test_nothing_that_expired_is_valid_again(computer: Computer, case: str) -> None:
    held: dict[str, str] = {}
    with ExitStack() as running:
        sessions, keys, user = running.enter_context(computer.service())
        for step in CASES[case]:
            match step:
                case "start":
                    sessions, keys, user = running.enter_context(computer.service())
                case "end":
                    running.close()
                case "log in":
                    held |= {"session": sessions.open(user, WHO)[1], "key": keys.add("line", Role.VIEWER, DAY, WHO)[1]}
                case "log in again":
                    held["again"] = sessions.open(user, WHO)[1]
                case "again":
                    assert valid(sessions, held["again"])
                case "told why":
                    found = sessions.find(held["session"])
                    assert found is not None
                    assert found.trouble(sessions.now()) == "the session of anna has expired: log in again"
                case "forgotten":
                    assert sessions.find(held["session"]) is None
                case "minute":
                    computer.minute()
                case "told":
                    entry = AuditStore(computer.began[-1]).newest(1)[0].entry
                    told = (entry["event"], entry["seconds"], entry["sessions"])
                    assert told == ("clock set back", 30 * 86400, 1)
                case ("pass", timedelta() as time):
                    computer.passes(time)
                case ("set", timedelta() as by):
                    computer.set(by)
                case _:
                    found = valid(sessions, held["session"]), valid(keys, held["key"])
                    assert found == {BOTH: (True, True), NONE: (False, False), KEY_ALONE: (False, True)}[str(step)]
                    assert found[0] or sessions.all() == ()


def test_two_services_with_different_clocks_share_one_time(computer: Computer) -> None:
    late = SteadyClock(lambda: computer.wall - HOUR, lambda: computer.running)
    with computer.service() as (sessions, _, user):
        _, session = sessions.open(user, WHO)
        with open_database(f"sqlite:///{computer.folder / 'sweepid.sqlite'}", clock=late) as other:
            there = SessionStore(other, idle=8 * 3600, longest=DAY.total_seconds())
            assert valid(there, session)
            computer.passes(25 * HOUR)
            assert not valid(there, session)


OTHER = "another twelve and more"


@pytest.fixture
def own(tmp_path: Path) -> Iterator[Database]:
    with open_database(f"sqlite:///{tmp_path / 'sweepid.sqlite'}") as database:
        yield database


def stored(database: Database, name: str) -> str:
    with database.read() as session:
        found = session.scalar(select(t.UserRow.password).where(t.UserRow.name == name))
    assert found is not None
    return found


def told(database: Database) -> list[str]:
    return [str(one.entry["event"]) for one in AuditStore(database).documents()]


@pytest.mark.parametrize(
    ("password", "typed"),
    [
        ("fünf Pferde im Stall", "fu\u0308nf Pferde im Stall"),
        *((x, x) for x in ("\ud800" * LEAST, "ﬀ" * LEAST, "p" * 5000)),
    ],
)
def test_a_password_fits_its_own_hash_alone_and_every_keyboard_types_it(password: str, typed: str) -> None:
    hashed = password_hash(password)
    assert hashed.startswith("$argon2id$")
    assert fits(typed, hashed)
    assert not outdated(hashed)
    assert not fits(f"{password} ", hashed)
    assert not fits(password, None)
    assert not fits(password, "no hash")


@pytest.mark.parametrize("password", ["", "eleven char"])
def test_a_short_password_is_refused_without_being_told(password: str) -> None:
    with pytest.raises(BadInput, match=rf"^password: has {len(password)} characters; use at least 12") as refused:
        password_hash(password)
    assert not password or password not in str(refused.value)


def test_users(own: Database) -> None:
    users = UserStore(own)
    anna = users.add("anna", Role.OPERATOR, PASSWORD, WHO)
    assert users.check("anna", PASSWORD) == anna
    assert users.check("anna", OTHER) is None
    assert users.check("berta", PASSWORD) is None
    with pytest.raises(Conflict, match="a user anna exists or existed: use another name"):
        users.add("anna", Role.ADMIN, PASSWORD, WHO)
    assert users.change_password("anna", OTHER, WHO) == anna
    assert users.check("anna", PASSWORD) is None
    assert users.check("anna", OTHER) == anna
    disabled = users.set_enabled("anna", WHO, enabled=False)
    assert users.set_enabled("anna", WHO, enabled=False) == disabled
    assert users.check("anna", OTHER) is None
    with pytest.raises(Conflict, match="anna was disabled on"):
        users.change_password("anna", PASSWORD, WHO)
    enabled = users.set_enabled("anna", WHO)
    assert users.set_enabled("anna", WHO) == enabled == anna
    assert users.check("anna", OTHER) == anna
    for change in (lambda: users.change_password("nobody", PASSWORD, WHO), lambda: users.set_enabled("nobody", WHO)):
        with pytest.raises(NotFound, match="user nobody does not exist"):
            change()
    assert told(own) == ["user added", "password changed", "user disabled", "user enabled"]


def test_a_name_is_a_users_or_a_keys(own: Database) -> None:
    users, keys = UserStore(own), KeyStore(own)
    users.add("anna", Role.OPERATOR, PASSWORD, WHO)
    keys.add("line-7", Role.OPERATOR, timedelta(days=1), WHO)
    with pytest.raises(Conflict, match="a user anna"):
        keys.add("anna", Role.VIEWER, timedelta(days=1), WHO)
    with pytest.raises(Conflict, match="a key of line-7"):
        users.add("line-7", Role.VIEWER, PASSWORD, WHO)


def test_a_hash_of_old_parameters_is_replaced(own: Database) -> None:
    users = UserStore(own)
    users.add("anna", Role.OPERATOR, PASSWORD, WHO)
    weak = PasswordHasher(time_cost=1, memory_cost=8192).hash(PASSWORD)
    with own.write() as session:
        session.execute(text("UPDATE user_account SET password = :weak"), {"weak": weak})
    assert outdated(weak)
    assert users.check("anna", OTHER) is None
    assert stored(own, "anna") == weak
    assert users.check("anna", PASSWORD) is not None
    assert not outdated(stored(own, "anna"))
    assert users.check("anna", PASSWORD) is not None


def test_the_commands_take_a_password_from_stdin(tmp_path: Path) -> None:
    def people(*words: str, stdin: str = "") -> tuple[int, str, str]:
        done = sweepid("people", *words, "--data-dir", str(tmp_path), stdin=stdin)
        return done.returncode, done.stdout, done.stderr

    def listed() -> dict[str, str]:
        return json.loads(people("list")[1])

    assert people("add-user", "anna", "--role", "operator", stdin=f"{PASSWORD}\n") == (0, "anna\n", "")
    code, out, err = people("change-password", "anna", stdin="short\n")
    assert (code, out, err.startswith("sweepid: password: has 5 characters")) == (2, "", True)
    assert people("change-password", "anna", stdin=OTHER) == (0, "anna\n", "")
    assert people("disable-user", "anna") == (0, "anna\n", "")
    line = listed()
    assert (line["kind"], line["name"], line["role"]) == ("user", "anna", "operator")
    assert line["trouble"].startswith("anna was disabled on ")
    assert "password" not in line
    assert people("enable-user", "anna") == (0, "anna\n", "")
    assert listed()["trouble"] == ""
    with open_database(f"sqlite:///{tmp_path / 'sweepid.sqlite'}") as database:
        assert told(database) == ["user added", "password changed", "user disabled", "user enabled"]
        assert AuditStore(database).documents()[-1].entry["user"] == "anna"
        assert fits(OTHER, stored(database, "anna"))


@pytest.mark.skipif(sys.platform == "win32", reason="a terminal of POSIX")
@pytest.mark.parametrize(("second", "code"), [(PASSWORD, 0), (OTHER, 2)])
def test_at_a_terminal_the_password_is_asked_for_twice_and_not_shown(tmp_path: Path, second: str, code: int) -> None:
    screen, terminal = os.openpty()
    arguments = ["people", "add-user", "anna", "--role", "viewer", "--data-dir", str(tmp_path)]
    # a session of its own, whose first terminal becomes the one that the password is read from
    begin = f"import os, sys; os.close(os.open({os.ttyname(terminal)!r}, os.O_RDWR)); os.execv({SWEEPID!r}, sys.argv)"
    asked = subprocess.Popen(
        [sys.executable, "-c", begin, *arguments],
        stdin=terminal,
        stdout=terminal,
        stderr=terminal,
        start_new_session=True,
    )
    os.close(terminal)
    shown = b""
    try:
        for prompt, answer in ((b"Password of anna: ", PASSWORD), (b"Once more: ", second)):
            while prompt not in shown:
                shown += os.read(screen, 1000)
            os.write(screen, f"{answer}\n".encode())
        assert asked.wait(60) == code
    finally:
        asked.kill()
        asked.wait()
        while rest := _rest(screen):
            shown += rest
        os.close(screen)
    assert PASSWORD.encode() not in shown
    assert (b"the two passwords differ" in shown) == (code == 2)
    with open_database(f"sqlite:///{tmp_path / 'sweepid.sqlite'}") as database:
        assert len(UserStore(database).all()) == (code == 0)


def _rest(screen: int) -> bytes:
    try:
        return os.read(screen, 1000)
    except OSError:  # the other end is closed
        return b""
