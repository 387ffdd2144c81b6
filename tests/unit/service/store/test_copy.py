"""`sweepid data copy`: SQLite to PostgreSQL and back, every row as it was; what is in the way is refused."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from sqlalchemy import text

from service.model.errors import BadInput
from service.model.recording import SweepSpec
from service.model.robot import Robot
from service.store import tables as t
from service.store.access.audit_chain import verify
from service.store.access.permissions import Role
from service.store.copying import RowsNotCopied, copy_rows
from service.store.database import Database, open_database
from service.store.documents import NewRecording, NewSweep, RecordingState
from service.store.guards import MachineLease, MachineTaken, StopLatch
from service.store.people.audit import AuditStore
from service.store.people.users import UserStore
from service.store.store import Store
from tests.command import sweepid

pytestmark = pytest.mark.slow

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
    sqlite_url: str, postgresql_url: str, tmp_path: Path, robot: Robot, specs: tuple[SweepSpec, ...]
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
        MachineLease(source, LEASE_TIME).acquire(wait=_must_not_wait)  # it was released each time
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


def _must_not_wait(_: float) -> None:
    pytest.fail("waited for a lease that is free")
