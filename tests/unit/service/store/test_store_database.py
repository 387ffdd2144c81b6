"""Durability settings, migrations, transactions."""

from pathlib import Path

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from sqlalchemy import create_engine, select, text
from sqlalchemy.exc import IntegrityError, OperationalError
from sqlalchemy.exc import TimeoutError as NoConnection

from service.model.robot import Robot
from service.store import tables as t
from service.store.database import Database, open_database, refusal
from service.store.store import Store

pytestmark = pytest.mark.slow


def test_sqlite_is_durable_and_keeps_references(sqlite_url: str) -> None:
    with open_database(sqlite_url) as database, database.read() as session:
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


def test_what_was_written_is_there_after_reopening(url: str, robot: Robot) -> None:
    with open_database(url) as database:
        added = Store(database).add_robot(robot)
    with open_database(url) as database:
        found = Store(database).robot(added.id)
    assert found == added
    assert found.build().urdf_text == robot.urdf_text


def test_a_transaction_that_fails_leaves_nothing(database: Database) -> None:
    told: list[str] = []
    database.on_write(lambda: told.append("written"))
    rows = [t.StopRow(machine_id=1, by="a", why="b"), t.PlanRow(robot_id=99, document={})]
    with pytest.raises(IntegrityError), database.write() as session:
        session.add_all(rows)
    with database.read() as session:
        assert session.scalars(select(t.StopRow)).all() == []
    assert told == []


def test_the_folder_of_the_database_is_made(tmp_path: Path) -> None:
    with open_database(f"sqlite:///{tmp_path / 'new' / 'x.sqlite'}") as database:
        assert Store(database).campaigns() == ()


def test_a_refusal_is_told_without_the_statement(sqlite_url: str) -> None:
    with open_database(sqlite_url) as database, pytest.raises(OperationalError) as refused, database.write() as session:
        session.execute(text("UPDATE no_table SET secret = 1"))
    assert refusal(refused.value) == "the database refused: no such table: no_table"
    assert refusal(NoConnection("all of the pool are taken")) == "the database refused: all of the pool are taken"
    assert refusal(NoConnection()) == "the database refused: TimeoutError"
