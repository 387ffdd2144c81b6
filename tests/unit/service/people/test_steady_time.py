"""The computer's clock is set back and ahead: nothing that expired is valid again, and no login outlives its limit."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from service.people.permissions import Role
from service.people.steady_clock import SteadyClock
from service.store.database import Database, open_database
from service.store.people.audit import AuditStore
from service.store.people.keys import KeyStore
from service.store.people.sessions import SessionStore
from service.store.people.time import begin_time, keep_time
from service.store.people.users import UserDocument, UserStore

pytestmark = pytest.mark.slow

WHO = {"actor": "test", "address": "test"}
HOUR, DAY = timedelta(hours=1), timedelta(days=1)
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


def test_an_expired_session_and_key_do_not_revive_when_the_clock_is_set_back(computer: Computer) -> None:
    with computer.service() as (sessions, keys, user):
        _, session = sessions.open(user, WHO)
        _, key = keys.add("line", Role.VIEWER, DAY, WHO)
        assert valid(sessions, session)
        assert valid(keys, key)
        computer.passes(25 * HOUR)
        assert not valid(sessions, session)
        assert not valid(keys, key)
        computer.set(-20 * HOUR)
        assert not valid(sessions, session)
        assert not valid(keys, key)
        computer.minute()
    with computer.service() as (sessions, keys, _):
        assert not valid(sessions, session)
        assert not valid(keys, key)
        assert sessions.all() == ()


def test_a_clock_that_is_set_back_does_not_extend_a_session(computer: Computer) -> None:
    with computer.service() as (sessions, keys, user):
        _, session = sessions.open(user, WHO)
        _, key = keys.add("line", Role.VIEWER, DAY, WHO)
        computer.set(-MONTH)
        for _ in range(23):
            computer.passes(HOUR)
            assert valid(sessions, session)
            assert valid(keys, key)
        computer.passes(2 * HOUR)
        assert not valid(sessions, session)
        assert not valid(keys, key)


def test_a_login_while_the_clock_stood_ahead_keeps_its_limit(computer: Computer) -> None:
    with computer.service() as (sessions, keys, user):
        computer.set(MONTH)
        _, session = sessions.open(user, WHO)
        _, key = keys.add("line", Role.VIEWER, DAY, WHO)
        computer.set(-MONTH)
        computer.passes(HOUR)
        assert valid(sessions, session)
        computer.passes(24 * HOUR)
        assert not valid(sessions, session)
        assert not valid(keys, key)


def test_a_restart_after_the_clock_was_set_back_ends_all_sessions(computer: Computer) -> None:
    with computer.service() as (sessions, keys, user):
        computer.set(MONTH)
        _, session = sessions.open(user, WHO)
        _, key = keys.add("line", Role.VIEWER, DAY, WHO)
    computer.set(-MONTH)
    with computer.service() as (sessions, keys, user):
        assert not valid(sessions, session)
        entry = AuditStore(computer.began[-1]).newest(1)[0].entry
        assert (entry["event"], entry["seconds"], entry["sessions"]) == ("clock set back", 30 * 86400, 1)
        assert valid(keys, key)
        computer.passes(25 * HOUR)
        assert not valid(keys, key)
        _, again = sessions.open(user, WHO)  # a person can log in meanwhile
        assert valid(sessions, again)


def test_what_was_expired_when_the_service_was_killed_stays_so(computer: Computer) -> None:
    with computer.service() as (sessions, _, user):
        _, session = sessions.open(user, WHO)
        computer.passes(9 * HOUR)  # idle
        computer.minute()
    computer.set(-4 * HOUR)
    with computer.service() as (sessions, _, _):
        assert not valid(sessions, session)


def test_a_small_correction_of_the_clock_ends_nothing(computer: Computer) -> None:
    with computer.service() as (sessions, _, user):
        _, session = sessions.open(user, WHO)
    computer.set(timedelta(seconds=-30))
    with computer.service() as (sessions, _, _):
        assert valid(sessions, session)
    computer.passes(HOUR)
    with computer.service() as (sessions, _, _):
        assert valid(sessions, session)


def test_two_services_with_different_clocks_share_one_time(computer: Computer) -> None:
    late = SteadyClock(lambda: computer.wall - HOUR, lambda: computer.running)
    with computer.service() as (sessions, _, user):
        _, session = sessions.open(user, WHO)
        with open_database(f"sqlite:///{computer.folder / 'sweepid.sqlite'}", clock=late) as other:
            there = SessionStore(other, idle=8 * 3600, longest=DAY.total_seconds())
            assert valid(there, session)
            computer.passes(25 * HOUR)
            assert not valid(there, session)
