"""SQLite and PostgreSQL: all differences between them, and which one a setting names.

SQLite is embedded: one file in the data folder. PostgreSQL, by psycopg 3, is a server, which may be unavailable at any
time. Its writers are serialised by one advisory lock of the database, as by the lock of SQLite's file. Therefore the
chain of the audit has no fork, the outbox is in order, and no writer reads rows that another one changes.
"""

import sqlite3
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sqlalchemy import URL, Connection, Engine, Table, create_engine, event, func, make_url, select
from sqlalchemy.engine import ExceptionContext
from sqlalchemy.exc import ArgumentError, DBAPIError, OperationalError
from sqlalchemy.pool import ConnectionPoolEntry

from service.model.errors import BadInput, SweepidError

BUSY_TIMEOUT = 30.0  # s to wait for another writer, or for an unavailable server
WRITE = "write"  # execution option of an engine: its transactions write
PATIENCE_OPTION = "patience"  # the same: s that such a transaction waits for another writer


class Sqlite:
    """SQLite, and what every database must give; its writers are serialised by its own lock, its readers do not wait.

    A writing transaction is exclusive: it waits at its begin, and sees everything committed before it. A reading
    transaction sees one consistent state and blocks no other. Committed data is on disk.
    """

    def __init__(self, url: URL) -> None:
        self._url = url

    def engine(self) -> Engine:
        """Connections with these properties, to a file whose folder is created. Raises BadInput if their driver is not
        installed.
        """
        if self._url.database:
            Path(self._url.database).parent.mkdir(parents=True, exist_ok=True)
        engine = create_engine(self._url, connect_args={"timeout": BUSY_TIMEOUT})
        event.listen(engine, "connect", _configure_sqlite)
        event.listen(engine, "begin", _begin_sqlite)
        return engine

    def check(self, engine: Engine) -> None:
        """Raises NotReached or BadInput if the database cannot be used; called once, before the migrations."""

    def is_away(self, error: OperationalError) -> bool:
        """Whether it is unavailable: a transaction without changes may begin again. SQLite has waited for its lock."""
        return False

    def continue_ids(self, connection: Connection, tables: Sequence[Table]) -> None:
        """After rows were inserted with their ids: the next row of each table gets an unused id, as always here."""

    def token(self, connection: Connection) -> str:
        """Token of the transaction that writes on this connection, for `was_committed`."""
        return ""

    def was_committed(self, engine: Engine, token: str) -> bool | None:
        """Whether the transaction without answer to its COMMIT was committed; None: not decided yet."""
        return False


def _configure_sqlite(connection: sqlite3.Connection, _: ConnectionPoolEntry) -> None:
    connection.isolation_level = None  # BEGIN is sent explicitly: see _begin_sqlite
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("PRAGMA synchronous = FULL")
    connection.execute("PRAGMA foreign_keys = ON")


def _begin_sqlite(connection: Connection) -> None:
    # IMMEDIATE: a writer waits at its begin instead of failing later when it upgrades its lock
    options = connection.get_execution_options()
    connection.exec_driver_sql(f"PRAGMA busy_timeout = {int(options.get(PATIENCE_OPTION, BUSY_TIMEOUT) * 1000)}")
    connection.exec_driver_sql("BEGIN IMMEDIATE" if options.get(WRITE, False) else "BEGIN")


class NotReached(SweepidError):
    """The server of the database does not answer or refuses the login (exit code 1)."""


class Postgresql(Sqlite):
    """PostgreSQL, a server."""

    def __init__(self, url: URL, password: str | None = None) -> None:
        """`password`: None if libpq finds it (``PGPASSFILE``), or none is needed."""
        super().__init__(url)
        self._password = password

    def engine(self) -> Engine:
        connecting: dict[str, str | int] = {
            "connect_timeout": 5,  # s
            "target_session_attrs": "read-write",  # no standby
            "application_name": "sweepid",
            # a server whose computer has failed does not answer: detected within about 15 s
            "keepalives_idle": 5,
            "keepalives_interval": 3,
            "keepalives_count": 3,
            "tcp_user_timeout": 15_000,
        }
        secret: dict[str, Any] = {} if self._password is None else {"password": self._password}
        try:
            # pre_ping: a connection that the server closed meanwhile is opened again before use
            engine = create_engine(self._url, pool_pre_ping=True, connect_args={**connecting, **secret})
        except ModuleNotFoundError as error:
            reason = f"PostgreSQL needs {error.name}: install sweepid with its extra, `sweepid[postgresql]`"
            raise BadInput("database_url", reason) from None
        event.listen(engine, "connect", _configure_postgresql)
        event.listen(engine, "begin", _begin_postgresql)
        event.listen(engine, "handle_error", _as_operational)
        return engine

    def check(self, engine: Engine) -> None:
        address = self._url.render_as_string(hide_password=True)
        try:
            with engine.connect() as connection:
                encoding = connection.exec_driver_sql("SHOW server_encoding").scalar_one()
        except DBAPIError as error:
            reason = str(error.orig).strip().partition("\n")[0]
            advice = "start the server, or correct `database_url`, `database_password_file` or PGPASSFILE"
            raise NotReached(f"{address}: the database cannot be used: {reason}; {advice}") from None
        if encoding != "UTF8":
            raise BadInput("database_url", f"{address} has encoding {encoding}; make one with `createdb -E UTF8`")

    def is_away(self, error: OperationalError) -> bool:
        state = getattr(error.orig, "sqlstate", None)
        # classes of SQLSTATE: no connection; the server stops, crashed or starts
        return state is None or str(state).startswith(("08", "57P"))

    def continue_ids(self, connection: Connection, tables: Sequence[Table]) -> None:
        for table in tables:
            column = table.autoincrement_column
            if column is not None:
                sequence = func.pg_get_serial_sequence(table.name, column.name)
                largest = select(func.max(column)).scalar_subquery()
                connection.execute(select(func.setval(sequence, largest)).where(largest.is_not(None)))

    def token(self, connection: Connection) -> str:
        return str(connection.info["transaction"])

    def was_committed(self, engine: Engine, token: str) -> bool | None:
        with engine.connect() as connection:
            status = connection.exec_driver_sql("SELECT pg_xact_status(%s::xid8)", (token,)).scalar_one()
        return None if status == "in progress" else status == "committed"


def _configure_postgresql(connection: Any, _: ConnectionPoolEntry) -> None:
    from psycopg.types.string import StrDumper

    class NoNul(StrDumper):
        """PostgreSQL does not support NUL in text; input of people and drives may contain one."""

        def dump(self, obj: str) -> Any:
            return super().dump(obj.replace("\0", "\N{REPLACEMENT CHARACTER}"))

    connection.adapters.register_dumper(str, NoNul)
    with connection.cursor() as cursor:
        for statement in (
            # the server detects a lost client in the same time, because it may hold the writers' lock
            "SET tcp_keepalives_idle = 5",
            "SET tcp_keepalives_interval = 3",
            "SET tcp_keepalives_count = 3",
            # ms of inactivity of a writer, e.g. after a power failure, until the next one may write
            "SET idle_in_transaction_session_timeout = 60000",
            # committed data is on disk, whatever the default of the server
            "SELECT set_config('synchronous_commit', 'on', false) WHERE current_setting('synchronous_commit') = 'off'",
        ):
            cursor.execute(statement)
    connection.commit()


def _begin_postgresql(connection: Connection) -> None:
    options = connection.get_execution_options()
    if not options.get(WRITE, False):
        connection.exec_driver_sql("SET TRANSACTION ISOLATION LEVEL REPEATABLE READ READ ONLY")
        return
    # READ COMMITTED: each statement after the lock sees the commit of the previous writer
    connection.exec_driver_sql("SET TRANSACTION ISOLATION LEVEL READ COMMITTED READ WRITE")
    connection.exec_driver_sql(f"SET LOCAL lock_timeout = {int(options.get(PATIENCE_OPTION, BUSY_TIMEOUT) * 1000)}")
    connection.exec_driver_sql(f"SELECT pg_advisory_xact_lock({0x73776565706964})")  # "sweepid"
    connection.info["transaction"] = connection.exec_driver_sql("SELECT pg_current_xact_id()::text").scalar_one()


def _as_operational(context: ExceptionContext) -> None:
    """A lost connection is the same error whichever class the driver raises."""
    raised = context.sqlalchemy_exception
    if context.is_disconnect and raised is not None and not isinstance(raised, OperationalError):
        raise OperationalError(context.statement, None, context.original_exception, connection_invalidated=True)


def kind_of(url: str, password_file: Path | None = None) -> Sqlite:
    """Raises BadInput for another database, a password in the URL, or a password file that cannot be read."""
    parsed = parsed_url(url)
    if parsed.get_backend_name() == "sqlite":
        return Sqlite(parsed)
    return Postgresql(parsed, None if password_file is None else _password(password_file))


def parsed_url(url: str) -> URL:
    """Raises BadInput as `kind_of`; the message never contains a possible password."""
    try:
        parsed = make_url(url)
    except (ArgumentError, ValueError):
        raise BadInput("database_url", "is not the URL of a database") from None
    if parsed.password is not None or "password" in parsed.query:
        raise BadInput(
            "database_url",
            "contains a password, which would appear in logs and process lists: put it into a file "
            "and set `database_password_file` (SWEEPID_DATABASE_PASSWORD_FILE), or use libpq's "
            "PGPASSFILE",
        )
    if parsed.drivername not in ("sqlite", "postgresql+psycopg"):
        reason = f"begins with {parsed.drivername!r}; sqlite:///... and postgresql+psycopg://... are known"
        raise BadInput("database_url", reason)
    return parsed


def _password(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8").rstrip("\r\n")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or type(error).__name__
        raise BadInput("database_password_file", f"{file} cannot be read: {reason}") from None
