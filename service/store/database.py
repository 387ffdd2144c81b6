"""Opens the database: migrations, durability, transactions. SQLite by default, PostgreSQL by URL."""

import sqlite3
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path

from alembic import command
from alembic.config import Config
from sqlalchemy import Connection, Engine, create_engine, event, make_url
from sqlalchemy.exc import DBAPIError, SQLAlchemyError
from sqlalchemy.orm import Session
from sqlalchemy.pool import ConnectionPoolEntry

BUSY_TIMEOUT = 30.0  # s to wait for another writer
MIGRATIONS = Path(__file__).parent / "migrations"


def refusal(error: SQLAlchemyError) -> str:
    """Why the database did not do it, in its own words, without the statement and what belongs to it."""
    own = error.orig if isinstance(error, DBAPIError) and error.orig is not None else error
    reason = str(own).partition("\n")[0] if own.args else ""
    return f"the database refused: {reason or type(own).__name__}"


class Database:
    """Transactions over one engine; usable from any thread."""

    def __init__(self, engine: Engine) -> None:
        self._reading = engine
        self._writing = engine.execution_options(write=True)
        self._listeners: list[Callable[[], None]] = []
        self.address = engine.url.render_as_string(hide_password=True)

    @contextmanager
    def read(self) -> Generator[Session]:
        """A session that sees one consistent state."""
        with Session(self._reading) as session, session.begin():
            yield session

    @contextmanager
    def write(self, quiet: bool = False, patience: float = BUSY_TIMEOUT) -> Generator[Session]:
        """A transaction: all or nothing, on disk when the block is left; listeners are told then, unless `quiet`.

        OperationalError after `patience` s in which SQLite had another writer.
        """
        engine = self._writing if patience == BUSY_TIMEOUT else self._writing.execution_options(patience=patience)
        with Session(engine) as session, session.begin():
            yield session
        if not quiet:
            for listener in self._listeners:
                listener()

    def on_write(self, listener: Callable[[], None]) -> None:
        """Call `listener` after every committed write that may have told an event, in the thread that wrote."""
        self._listeners.append(listener)


@contextmanager
def open_database(url: str) -> Generator[Database]:
    """The database at `url`, brought to the newest schema; closed on leaving."""
    parsed = make_url(url)
    sqlite = parsed.get_backend_name() == "sqlite"
    if sqlite and parsed.database:
        Path(parsed.database).parent.mkdir(parents=True, exist_ok=True)
    engine = create_engine(parsed, connect_args={"timeout": BUSY_TIMEOUT} if sqlite else {})
    if sqlite:
        event.listen(engine, "connect", _configure_sqlite)
        event.listen(engine, "begin", _begin_sqlite)
    try:
        migrate(engine)
        yield Database(engine)
    finally:
        engine.dispose()


def migrate(engine: Engine) -> None:
    """Bring the schema to the newest revision, in one transaction."""
    with engine.execution_options(write=True).begin() as connection:
        command.upgrade(alembic_config(connection), "head")


def alembic_config(connection: Connection) -> Config:
    """Alembic's configuration for the migrations in this package, on an open connection."""
    config = Config()
    config.set_main_option("script_location", str(MIGRATIONS).replace("%", "%%"))
    config.set_main_option("path_separator", "os")
    config.attributes["connection"] = connection
    return config


def _configure_sqlite(connection: sqlite3.Connection, _: ConnectionPoolEntry) -> None:
    connection.isolation_level = None  # we say BEGIN ourselves: see _begin_sqlite
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("PRAGMA synchronous = FULL")
    connection.execute("PRAGMA foreign_keys = ON")


def _begin_sqlite(connection: Connection) -> None:
    # IMMEDIATE: a writer waits for its turn at the start instead of failing half-way when it upgrades its lock
    options = connection.get_execution_options()
    connection.exec_driver_sql(f"PRAGMA busy_timeout = {int(options.get('patience', BUSY_TIMEOUT) * 1000)}")
    connection.exec_driver_sql("BEGIN IMMEDIATE" if options.get("write", False) else "BEGIN")
