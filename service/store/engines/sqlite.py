"""SQLite: the database embedded in the service, one file in the data folder."""

import sqlite3
from collections.abc import Sequence
from pathlib import Path

from sqlalchemy import URL, Connection, Engine, Table, create_engine, event
from sqlalchemy.exc import OperationalError
from sqlalchemy.pool import ConnectionPoolEntry

from service.store.engines.kind import BUSY_TIMEOUT, PATIENCE, WRITE


class Sqlite:
    """`Kind` for SQLite. Its writers are serialised by SQLite's own lock; readers of a WAL do not wait."""

    def __init__(self, url: URL) -> None:
        self._url = url

    def engine(self) -> Engine:
        """Creates the folder of the file."""
        if self._url.database:
            Path(self._url.database).parent.mkdir(parents=True, exist_ok=True)
        engine = create_engine(self._url, connect_args={"timeout": BUSY_TIMEOUT})
        event.listen(engine, "connect", _configure)
        event.listen(engine, "begin", _begin)
        return engine

    def check(self, engine: Engine) -> None:
        """Nothing to check for a file."""

    def is_away(self, error: OperationalError) -> bool:
        """Never: SQLite itself has waited for the lock of the file."""
        return False

    def continue_ids(self, connection: Connection, tables: Sequence[Table]) -> None:
        """SQLite continues from the largest id."""

    def token(self, connection: Connection) -> str:
        return ""

    def was_committed(self, engine: Engine, token: str) -> bool | None:
        """A COMMIT that raises did not commit."""
        return False


def _configure(connection: sqlite3.Connection, _: ConnectionPoolEntry) -> None:
    connection.isolation_level = None  # BEGIN is sent explicitly: see _begin
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("PRAGMA synchronous = FULL")
    connection.execute("PRAGMA foreign_keys = ON")


def _begin(connection: Connection) -> None:
    # IMMEDIATE: a writer waits at its begin instead of failing later when it upgrades its lock
    options = connection.get_execution_options()
    connection.exec_driver_sql(f"PRAGMA busy_timeout = {int(options.get(PATIENCE, BUSY_TIMEOUT) * 1000)}")
    connection.exec_driver_sql("BEGIN IMMEDIATE" if options.get(WRITE, False) else "BEGIN")
