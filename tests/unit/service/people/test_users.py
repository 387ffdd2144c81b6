"""People with passwords: what is stored, who is told apart, and the commands at a real terminal."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path

import pytest
from argon2 import PasswordHasher
from sqlalchemy import select, text

from service.model.errors import BadInput, Conflict, NotFound
from service.store import tables as t
from service.store.access.permissions import Role
from service.store.database import Database, open_database
from service.store.people.audit import AuditStore
from service.store.people.users import LEAST, KeyStore, UserStore, fits, outdated, password_hash
from tests.command import SWEEPID, sweepid

pytestmark = pytest.mark.slow

WHO = {"actor": "test"}
PASSWORD = "a horse and a battery"
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


@pytest.mark.parametrize("password", [PASSWORD, "x" * LEAST, "\ud800" * LEAST, "ﬀ" * LEAST, "p" * 5000])
def test_a_password_fits_its_own_hash_alone(password: str) -> None:
    hashed = password_hash(password)
    assert hashed.startswith("$argon2id$")
    assert fits(password, hashed)
    assert not outdated(hashed)
    assert not fits(f"{password} ", hashed)
    assert not fits(password, None)
    assert not fits(password, "no hash")


def test_every_keyboard_types_the_same_password() -> None:
    assert fits("fu\u0308nf Pferde im Stall", password_hash("fünf Pferde im Stall"))


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
    disabled = users.shut_out("anna", WHO)
    assert users.shut_out("anna", WHO) == disabled
    assert users.check("anna", OTHER) is None
    with pytest.raises(Conflict, match="anna was disabled on"):
        users.change_password("anna", PASSWORD, WHO)
    enabled = users.let_in("anna", WHO)
    assert users.let_in("anna", WHO) == enabled == anna
    assert users.check("anna", OTHER) == anna
    for name in ("change_password", "shut_out", "let_in"):
        arguments = ("nobody", PASSWORD, WHO) if name == "change_password" else ("nobody", WHO)
        with pytest.raises(NotFound, match="user nobody does not exist"):
            getattr(users, name)(*arguments)
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
