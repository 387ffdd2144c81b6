"""The computer's clock is set back and ahead: nothing that expired is valid again, and no login outlives its limit."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from service.store.access.permissions import Role
from service.store.database import Database, SteadyClock, open_database
from service.store.people.audit import AuditStore
from service.store.people.sessions import SessionStore, begin_time, keep_time
from service.store.people.users import KeyStore, UserDocument, UserStore

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


Step = str | tuple[str, timedelta]
BOTH, NONE, KEY_ALONE = "both", "none", "the key alone"  # of session and key are valid
RESTART = ("end", "start")
CASES: dict[str, list[Step]] = {
    "what has expired does not revive when the clock is set back": [
        *("log in", BOTH, ("pass", 25 * HOUR), NONE, ("set", -20 * HOUR), NONE, "minute", *RESTART, NONE),
    ],
    "a clock that is set back extends nothing": [
        *("log in", ("set", -MONTH)),
        *(step for _ in range(23) for step in (("pass", HOUR), BOTH)),
        *(("pass", 2 * HOUR), NONE),
    ],
    "a login while the clock stood ahead keeps its limit": [
        *(("set", MONTH), "log in", ("set", -MONTH), ("pass", HOUR), BOTH, ("pass", 24 * HOUR), NONE),
    ],
    "a restart after the clock was set back ends the session": [
        *(("set", MONTH), "log in", "end", ("set", -MONTH), "start", KEY_ALONE, "told", ("pass", 25 * HOUR), NONE),
        *("log in again", "again"),  # a person can, meanwhile
    ],
    "what was expired when the service was killed stays so": [
        *("log in", ("pass", 9 * HOUR), "minute", "end", ("set", -4 * HOUR), "start", KEY_ALONE),
    ],
    "a small correction ends nothing": [
        *("log in", "end", ("set", timedelta(seconds=-30)), "start", BOTH, "end", ("pass", HOUR), "start", BOTH),
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
