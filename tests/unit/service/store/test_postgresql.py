"""What a server of its own brings: writers at once, a lost connection at any moment, secrets, what `doctor` finds."""

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from sqlalchemy import text
from sqlalchemy.exc import IntegrityError, OperationalError
from sqlalchemy.orm import Session

from service.model.errors import BadInput
from service.store.access.audit_chain import verify
from service.store.database import open_database
from service.store.engines import NotReached, parsed_url
from service.store.examination import examine, examined
from service.store.files.data_folder import FILE, claim_folder
from service.store.guards import StopLatch
from service.store.people.audit import AuditStore
from service.store.store import Store
from tests.postgresql_server import PASSWORD, PostgresqlServer, running_server

pytestmark = pytest.mark.slow

WRITERS, ENTRIES = 3, 40

WRITER = """
import sys
from service.store.database import open_database
from service.store.guards import StopLatch
from service.store.people.audit import AuditStore
with open_database(sys.argv[1]) as database:
    for number in range(int(sys.argv[2])):
        AuditStore(database).append([{"event": "request", "actor": sys.argv[3]}])
        StopLatch(database).latch(sys.argv[3], str(number))
"""


@pytest.fixture(scope="module")
def own() -> Iterator[PostgresqlServer]:
    """One to stop and kill."""
    with running_server() as server:
        yield server


def test_writers_at_once_make_one_chain_and_the_outbox_has_no_gap_for_who_follows(postgresql_url: str) -> None:
    with open_database(postgresql_url) as database:
        command = [sys.executable, "-c", WRITER, postgresql_url, str(ENTRIES)]
        writers = [subprocess.Popen([*command, str(n)]) for n in range(WRITERS)]
        followed, after = list[int](), 0
        while any(writer.poll() is None for writer in writers):
            followed += [event.id for event in Store(database).events(after)]
            after = followed[-1] if followed else 0
        assert [writer.returncode for writer in writers] == [0] * WRITERS
        while events := Store(database).events(after):
            followed += [event.id for event in events]
            after = followed[-1]
        with database.read() as session:
            stored = session.scalars(text("SELECT id FROM event ORDER BY id")).all()
        assert followed == stored
        assert len(stored) == WRITERS * ENTRIES
        assert verify(AuditStore(database).links())[0] == WRITERS * ENTRIES


@pytest.mark.parametrize(
    "statement",
    [
        *("UPDATE audit SET entry = '{}'", "DELETE FROM audit", "TRUNCATE audit"),
        *(
            f"INSERT INTO audit VALUES ({number}, '{{}}', 'abc') "
            "ON CONFLICT (number) DO UPDATE SET entry = EXCLUDED.entry, sha256 = EXCLUDED.sha256"
            for number in (1, 2, 4)
        ),
    ],
)
def test_entries_are_only_added(postgresql_url: str, statement: str) -> None:
    with open_database(postgresql_url) as database:
        AuditStore(database).append([{"event": "request", "actor": "ada"}] * 2)
        with pytest.raises(IntegrityError, match="only ever added to"), database.write() as session:
            session.execute(text(statement))
        assert verify(AuditStore(database).links())[0] == 2


def test_a_writer_waits_for_its_turn_as_long_as_it_said(postgresql_url: str) -> None:
    with open_database(postgresql_url) as first, open_database(postgresql_url) as second, first.write() as held:
        held.execute(text("SELECT 1"))
        with pytest.raises(OperationalError, match="lock timeout"), second.write(patience=0.2):
            pytest.fail("two write at once")
        with second.read() as session:  # who reads waits for nobody
            assert session.scalar(text("SELECT count(*) FROM stop")) == 0


def test_a_server_that_is_killed_loses_nothing_and_work_goes_on(own: PostgresqlServer) -> None:
    with open_database(own.new_database(), own.password_file) as database:
        latch = StopLatch(database)
        first = latch.latch("anna", "one")
        with pytest.raises(OperationalError), database.read() as session:
            cut_off(own, session)
        with pytest.raises(OperationalError), database.write(patience=0.5):
            pytest.fail("there is no server")
        own.start()
        second = latch.latch("anna", "two")
        own.stop()
        own.start()
        assert latch.latched() == (first, second)  # by a connection that was closed meanwhile


def cut_off(server: PostgresqlServer, session: Session) -> None:
    """In the middle of a transaction. The process of the connection ends a moment after its server."""
    session.execute(text("SELECT 1"))
    server.kill()
    for _ in range(600):
        session.execute(text("SELECT 1"))
        time.sleep(0.05)


def test_no_password_is_told(own: PostgresqlServer, tmp_path: Path) -> None:
    wrong = tmp_path / "wrong"
    wrong.write_text("another-secret", "utf-8")
    url = own.new_database()
    with pytest.raises(NotReached, match="password authentication failed") as refused:
        open_database(url, wrong).__enter__()
    assert "another-secret" not in str(refused.value)
    with open_database(url, own.password_file) as database:
        assert claim_folder(tmp_path, database) == ""
        assert PASSWORD not in database.address + repr(vars(database)) + (tmp_path / FILE).read_text("utf-8")
    for told in (url.replace("cell@", f"cell:{PASSWORD}@"), f"{url}?password={PASSWORD}", f"post gres {PASSWORD}"):
        with pytest.raises(BadInput, match=r"^database_url: ") as bad:
            parsed_url(told)
        assert PASSWORD not in str(bad.value)
    with pytest.raises(BadInput, match="mysql"):
        parsed_url("mysql://db/sweepid")
    with pytest.raises(BadInput, match=r"^database_password_file: .*No such file"):
        open_database(url, tmp_path / "none").__enter__()


def test_what_doctor_finds(own: PostgresqlServer, postgresql_url: str, tmp_path: Path) -> None:
    """The shared server of the tests gives what is stored no time to reach the disk."""
    url = own.new_database()
    with open_database(url, own.password_file) as database, open_database(postgresql_url):
        claim_folder(tmp_path, database)
        assert examine(examined(url, own.password_file), tmp_path, 0) == ()
        with database.write() as session:
            session.execute(text("ALTER TABLE audit DISABLE TRIGGER audit_no_delete"))
        (found,) = examine(examined(url, own.password_file), tmp_path, 0)
        assert "the triggers that protect the audit" in found.line
        told = [each.what for each in examine(examined(postgresql_url), tmp_path, 0)]
        assert "fsync is off" in told[0]
        assert "the data folder belongs to database" in told[1]
        assert json.loads((tmp_path / FILE).read_text("utf-8"))["database"] == url
    (gone,) = examine(examined(url + "none", own.password_file), tmp_path, 0)
    assert "does not exist" in gone.what
