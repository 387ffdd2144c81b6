"""Durability settings, migrations, transactions."""

import hashlib
import json
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from sqlalchemy import create_engine, select, text
from sqlalchemy.exc import IntegrityError, OperationalError, TimeoutError as NoConnection
from sqlalchemy.orm import Session

from service import BadInput
from service.model import Robot, SweepSpec
from service.store import tables as t
from service.store.access import Role
from service.store.copying import RowsNotCopied, copy_rows
from service.store.database import Database, NotReached, known_schemas, open_database, parsed_url, refusal
from service.store.documents import NewRecording, NewSweep, RecordingState
from service.store.examination import examine, examined
from service.store.files.data_folder import OWNER_FILE, claim_folder
from service.store.lease_and_latch import MachineLease, MachineTaken, StopLatch
from service.store.people.audit import AuditStore, verify
from service.store.people.users import UserStore
from service.store.store import Store
from tests.command import sweepid
from tests.postgresql_server import PASSWORD, PostgresqlServer, running_server
from tests.unit.service.store.conftest import Specs, must_not_wait

pytestmark = pytest.mark.slow


def test_sqlite_is_durable_and_keeps_references_in_a_folder_that_is_made(tmp_path: Path) -> None:
    with open_database(f"sqlite:///{tmp_path / 'new' / 'x.sqlite'}") as database, database.read() as session:
        pragma = {
            name: session.scalar(text(f"PRAGMA {name}")) for name in ("journal_mode", "synchronous", "foreign_keys")
        }
    assert pragma == {"journal_mode": "wal", "synchronous": 2, "foreign_keys": 1}


def test_migrations_give_exactly_the_tables(url: str, database: Database) -> None:
    engine = create_engine(url)
    with engine.connect() as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True})
        assert compare_metadata(context, t.StoredRow.metadata) == []
    engine.dispose()


def test_a_changed_table_needs_a_migration() -> None:
    """A new database gets the tables as they are, so a revision must take the stored ones there: `alembic revision`."""
    found = [
        f"{column} {column.type} {column.nullable} {column.primary_key} {column.unique} {column.index} "
        + " ".join(key.target_fullname for key in column.foreign_keys)
        for table in t.StoredRow.metadata.tables.values()
        for column in table.columns
    ]
    told = hashlib.sha256("\n".join(sorted(found)).encode()).hexdigest()[:12]
    assert (known_schemas()[-1], told) == ("0001", "9f92e5b992db")


def test_a_transaction_that_fails_leaves_nothing(database: Database) -> None:
    told: list[str] = []
    database.on_write(lambda: told.append("written"))
    rows = [t.StopRow(machine_id=1, by="a", why="b"), t.PlanRow(robot_id=99, document={})]
    with pytest.raises(IntegrityError), database.write() as session:
        session.add_all(rows)
    with database.read() as session:
        assert session.scalars(select(t.StopRow)).all() == []
    assert told == []


def test_a_refusal_is_told_without_the_statement(sqlite_url: str) -> None:
    with open_database(sqlite_url) as database, pytest.raises(OperationalError) as refused, database.write() as session:
        session.execute(text("UPDATE no_table SET secret = 1"))
    assert refusal(refused.value) == "the database refused: no such table: no_table"
    assert refusal(NoConnection("all of the pool are taken")) == "the database refused: all of the pool are taken"
    assert refusal(NoConnection()) == "the database refused: TimeoutError"


LEASE_TIME = 0.5  # s


def quiet(table: str, rows: int) -> None:
    pass


def fill(database: Database, robot: Robot, spec: SweepSpec) -> None:
    store = Store(database)
    added = store.add_robot(robot)
    recording = NewRecording(state=RecordingState.COMPLETE, path="x", sha256="0" * 64, samples=10)
    store.add_measured(added.id, [NewSweep(spec=spec, mode=None)], [recording])
    store.add_plan(added.id, {"third": 1 / 3, "tiny": 5e-324, "word": "ü \u2028"})
    StopLatch(database).latch("an\0na", "smoke")
    UserStore(database).add("anna", Role.OPERATOR, "a horse and a battery", {"actor": "test"})
    with database.write() as session:  # two tables that refer to each other
        campaigns = {"machine_id": 1, "robot_id": added.id, "campaigns": [1], "axes": ["joint_1"], "unattended": False}
        session.add(t.DiagnosisRow(**{**campaigns, "state": t.DiagnosisState.DONE}))
        session.flush()
        session.add(t.ModelRow(robot_id=added.id, revision=1, diagnosis_id=1, accepted_by="anna", document={}))
        session.flush()
        session.add(t.DiagnosisRow(**{**campaigns, "state": t.DiagnosisState.DONE}, parent=1, model=1))


@contextmanager
def two(first: str, second: str) -> Iterator[tuple[Database, Database]]:
    with open_database(first) as source, open_database(second) as target:
        yield source, target


def test_there_and_back_nothing_changes(
    sqlite_url: str, postgresql_url: str, tmp_path: Path, robot: Robot, specs: Specs
) -> None:
    back = f"sqlite:///{tmp_path / 'back.sqlite'}"
    with open_database(sqlite_url) as database:
        fill(database, robot, specs[0])
    told = sweepid("data", "copy", "--from", sqlite_url, "--to", postgresql_url)
    assert told.returncode == 0, told.stderr
    with two(postgresql_url, back) as (source, target):
        assert f"{copy_rows(source, target, LEASE_TIME, quiet)} rows\n" == told.stdout
        assert "diagnosis: 2 rows\n" in told.stderr
        for database in (source, target):
            assert verify(AuditStore(database).links())[0] == 1
            assert Store(database).plan(1).document == {"third": 1 / 3, "tiny": 5e-324, "word": "ü \u2028"}
            assert StopLatch(database).latched()[0].by == "an\N{REPLACEMENT CHARACTER}na"
            with database.read() as session:
                assert session.get_one(t.DiagnosisRow, 2).model == 1
            before = Store(database).last_event_id()
            assert StopLatch(database).latch("otto", "again").id == 2  # ids go on
            assert Store(database).last_event_id() == before + 1


def test_what_is_in_the_way_is_refused(sqlite_url: str, postgresql_url: str) -> None:
    with two(sqlite_url, postgresql_url) as (source, target):
        lease = MachineLease(source, LEASE_TIME)
        lease.acquire()
        with renewed(lease), pytest.raises(MachineTaken):
            copy_rows(source, target, LEASE_TIME, quiet)
        lease.release()
        StopLatch(target).latch("anna", "smoke")
        with pytest.raises(BadInput, match=r"^--to: .* not empty: there are rows in its table stop"):
            copy_rows(source, target, LEASE_TIME, quiet)
        with pytest.raises(BadInput, match="is the database to copy from"):
            copy_rows(source, source, LEASE_TIME, quiet)
        MachineLease(source, LEASE_TIME).acquire(wait=must_not_wait)  # it was released each time
    gone = sweepid("data", "copy", "--from", f"{sqlite_url}.none", "--to", postgresql_url)
    assert (gone.returncode, "does not exist" in gone.stderr) == (2, True)


def test_a_row_that_the_target_does_not_take_leaves_nothing(sqlite_url: str, postgresql_url: str) -> None:
    with two(sqlite_url, postgresql_url) as (source, target):
        with source.write() as session:
            session.add(t.RobotRow(sha256="0" * 65, name="too long", description={}, urdf_text=""))
        with pytest.raises(RowsNotCopied, match=r"^nothing was copied: the database refused: value too long"):
            copy_rows(source, target, LEASE_TIME, quiet)
        assert Store(target).robots() == ()
        with source.write() as session:
            session.execute(text("UPDATE robot SET sha256 = '1'"))
        assert copy_rows(source, target, LEASE_TIME, quiet) > 0


@contextmanager
def renewed(lease: MachineLease) -> Iterator[None]:
    """As a service that runs renews it."""
    ended = threading.Event()

    def renew() -> None:
        while not ended.wait(LEASE_TIME / 10):
            lease.renew()

    thread = threading.Thread(target=renew, name="renew")
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


WRITERS, ENTRIES = 3, 40

WRITER = """
import sys
from service.store.database import open_database
from service.store.lease_and_latch import StopLatch
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


UPSERTS = tuple(
    f"INSERT INTO audit VALUES ({number}, '{{}}', 'abc') "
    "ON CONFLICT (number) DO UPDATE SET entry = EXCLUDED.entry, sha256 = EXCLUDED.sha256"
    for number in (1, 2, 4)
)
REWRITES = {
    "postgresql": ("DELETE FROM audit", "TRUNCATE audit"),
    "sqlite": (
        "DELETE FROM audit WHERE number = 2",
        "INSERT OR REPLACE INTO audit VALUES (1, '{}', 'abc')",
        "REPLACE INTO audit VALUES (2, '{}', 'abc')",
        "UPDATE OR REPLACE audit SET number = 1 WHERE number = 2",
        "INSERT INTO audit VALUES (4, '{}', 'abc')",
        "INSERT INTO audit VALUES (0, '{}', 'abc')",
    ),
}


@pytest.mark.parametrize(
    ("url", "statement"),
    [(kind, each) for kind in REWRITES for each in ("UPDATE audit SET entry = '{}'", *UPSERTS, *REWRITES[kind])],
    indirect=["url"],
)
def test_entries_are_only_added(url: str, statement: str) -> None:
    with open_database(url) as database:
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
        assert PASSWORD not in database.address + repr(vars(database)) + (tmp_path / OWNER_FILE).read_text("utf-8")
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
        assert json.loads((tmp_path / OWNER_FILE).read_text("utf-8"))["database"] == url
    (gone,) = examine(examined(url + "none", own.password_file), tmp_path, 0)
    assert "does not exist" in gone.what
