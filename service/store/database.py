"""Opens the database: migrations, transactions. SQLite by default, PostgreSQL by URL.

SQLite and PostgreSQL: all differences between them, and which one a setting names.

SQLite is embedded: one file in the data folder. PostgreSQL, by psycopg 3, is a server, which may be unavailable at any
time. Its writers are serialised by one advisory lock of the database, as by the lock of SQLite's file. Therefore the
chain of the audit has no fork, the outbox is in order, and no writer reads rows that another one changes.
"""

import sqlite3
import threading
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from uuid import uuid4

from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import URL, Connection, Engine, Table, create_engine, event, func, insert, make_url, select
from sqlalchemy.engine import ExceptionContext
from sqlalchemy.exc import ArgumentError, DBAPIError, OperationalError, SQLAlchemyError
from sqlalchemy.orm import Session
from sqlalchemy.pool import ConnectionPoolEntry

from service import BadInput, SweepidError
from service.store import tables as t

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


MIGRATIONS = Path(__file__).parent / "migrations"
MACHINE = "machine"  # default name of a machine


def refusal(error: SQLAlchemyError) -> str:
    """Reason of the database, in its own words, without the statement and its parameters."""
    own = error.orig if isinstance(error, DBAPIError) and error.orig is not None else error
    reason = str(own).partition("\n")[0] if own.args else ""
    return f"the database refused: {reason or type(own).__name__}"


def _wall() -> datetime:
    return datetime.now(UTC)


class SteadyClock:
    """Time for sessions and keys: it never runs backward. Of one process; usable from any thread.

    It is the wall clock while that runs forward. When the clock is set back, it runs on from where it was, by the
    monotonic clock; over a restart, from the time that the database keeps. So nothing that has expired is valid again,
    and what was issued while the clock was ahead keeps its limit from then on.
    """

    def __init__(self, wall: Callable[[], datetime] = _wall, monotonic: Callable[[], float] = time.monotonic) -> None:
        self.wall, self._monotonic = wall, monotonic
        self._lock = threading.Lock()
        self._at, self._since = wall(), monotonic()

    def now(self, kept: datetime | None = None) -> datetime:
        """`kept`: the time that the database keeps; this one is never before it."""
        with self._lock:
            since = self._monotonic()
            elapsed = self._at + timedelta(seconds=since - self._since)
            self._at, self._since = max(self.wall(), elapsed, kept or elapsed), since
            return self._at


class Database:
    """Transactions over one engine; usable from any thread.

    `machine`: written rows belong to it; None if the service owns none: then nothing of a machine can be written.
    """

    def __init__(self, engine: Engine, kind: Sqlite, machine: t.OwnMachine | None, clock: SteadyClock) -> None:
        self._reading, self._kind, self.machine, self.clock = engine, kind, machine, clock
        self._writing = engine.execution_options(**{WRITE: True})
        self._listeners: list[Callable[[], None]] = []
        self.address = engine.url.render_as_string(hide_password=True)

    def now(self, session: Session) -> datetime:
        """The time of sessions and keys: not before that in the database."""
        return self.clock.now(session.scalar(select(t.SteadyTimeRow.at)))

    def keep_time(self, session: Session) -> None:
        """Store this time, so that a restart does not begin before it."""
        at = self.now(session)
        row = session.get(t.SteadyTimeRow, 1)
        if row is None:
            session.add(t.SteadyTimeRow(id=1, at=at))
        else:
            row.at = at

    @contextmanager
    def read(self) -> Generator[Session]:
        """A session that sees one consistent state."""
        with self._begun(self._reading, patience=10.0) as session:
            yield session
            session.commit()

    @contextmanager
    def write(self, quiet: bool = False, patience: float | None = None) -> Generator[Session]:
        """A transaction: all or nothing, on disk at the end of the block. Then listeners are called, unless `quiet`.

        There is no other writer meanwhile. Raises OperationalError after waiting `patience` s (`BUSY_TIMEOUT`) for
        another writer or the server.
        """
        engine, patience = self._writing, BUSY_TIMEOUT if patience is None else patience
        if patience != BUSY_TIMEOUT:
            engine = engine.execution_options(**{PATIENCE_OPTION: patience})
        with self._begun(engine, patience) as session:
            token = self._kind.token(session.connection())
            yield session
            session.flush()
            try:
                session.commit()
            except OperationalError as error:
                if not (self._kind.is_away(error) and self._was_committed(token, patience)):
                    raise
        if not quiet:
            for listener in self._listeners:
                listener()

    def on_write(self, listener: Callable[[], None]) -> None:
        """Call `listener` after every committed write that may have added an event, in the writing thread."""
        self._listeners.append(listener)

    def continue_ids(self, session: Session, tables: Sequence[Table]) -> None:
        """After rows were inserted with their ids: the next row of each table gets an unused id."""
        self._kind.continue_ids(session.connection(), tables)

    def _begun(self, engine: Engine, patience: float) -> Session:
        """A session in its transaction; repeated for `patience` s while the server is unavailable."""
        deadline = time.monotonic() + patience
        while True:
            session = Session(engine, info={t.OfMachine.own: self.machine})
            try:
                session.connection()
            except OperationalError as error:
                session.close()
                if not self._kind.is_away(error) or time.monotonic() >= deadline:
                    raise
            except BaseException:
                session.close()
                raise
            else:
                return session
            time.sleep(0.2)

    def _was_committed(self, token: str, patience: float) -> bool:
        """Whether a transaction was committed whose COMMIT the server received but did not answer."""
        deadline = time.monotonic() + patience
        while time.monotonic() < deadline:
            try:
                committed = self._kind.was_committed(self._reading, token)
            except OperationalError:  # the server is still unavailable
                committed = None
            if committed is not None:
                return committed
            time.sleep(0.2)
        return False


@contextmanager
def open_database(
    url: str,
    password_file: Path | None = None,
    machine: str | None = MACHINE,
    migrated: bool = True,
    clock: SteadyClock | None = None,
) -> Generator[Database]:
    """The database at `url`, migrated to the newest schema; closed at the end of the block. Raises BadInput,
    NotReached.

    `password_file`: password of a server's user, if it is not in libpq's PGPASSFILE and one is needed. `machine`:
    name of the owned machine, added if it is new; None: none. `migrated`: False does not change the schema, and
    raises BadInput if it differs from that of this version. `clock`: None: that of this computer.
    """
    kind = kind_of(url, password_file)
    engine = kind.engine()
    try:
        kind.check(engine)
        _check_schema(engine, migrated)
        if migrated:
            migrate(engine)
        yield Database(engine, kind, None if machine is None else _named(engine, machine), clock or SteadyClock())
    finally:
        engine.dispose()


def _named(engine: Engine, name: str) -> t.OwnMachine:
    """The row of the machine with this name, added if it is new."""
    with Session(engine.execution_options(**{WRITE: True})) as session:
        row = session.scalar(select(t.MachineRow).where(t.MachineRow.name == name))
        if row is None:
            row = t.MachineRow(name=name)
            session.add(row)
        session.commit()
        return t.OwnMachine(row.id, row.name)


def _check_schema(engine: Engine, migrated: bool) -> None:
    """Raises BadInput unless the database has this version's schema, or (`migrated`) an older one or none."""
    with engine.connect() as connection:
        found = MigrationContext.configure(connection).get_current_revision()
    known = known_schemas()
    if found == known[-1] or (migrated and (found is None or found in known)):
        return
    address = engine.url.render_as_string(hide_password=True)
    if found is not None and found not in known:
        raise BadInput("database_url", f"{address} {unknown_schema(found)}")
    raise BadInput(
        "database_url",
        f"{address} has schema {found or 'none'}, this version reads {known[-1]}: first start a service of this "
        "version that owns a machine, or use the version of the others",
    )


def known_schemas() -> tuple[str, ...]:
    """The revisions that this version can open, the newest last."""
    newest_first = ScriptDirectory(str(MIGRATIONS)).walk_revisions()
    return tuple(script.revision for script in newest_first)[::-1]


def unknown_schema(found: str) -> str:
    """What is wrong with a schema that is not among the known ones."""
    return f"has schema {found}, which this sweepid does not know: use the sweepid that wrote it"


def migrate(engine: Engine) -> None:
    """Migrate the schema to the newest revision, in one transaction. A new database gets the tables as they are."""
    with engine.execution_options(**{WRITE: True}).begin() as connection:
        if MigrationContext.configure(connection).get_current_revision() is not None:
            command.upgrade(alembic_config(connection), "head")
            return
        t.StoredRow.metadata.create_all(connection, checkfirst=False)
        connection.execute(insert(t.IdentityRow).values(id=uuid4().hex))
        # not by an explicit id: the sequence of a server would not know of it
        connection.execute(insert(t.MachineRow).values(name=MACHINE))
        command.stamp(alembic_config(connection), "head")


def alembic_config(connection: Connection) -> Config:
    """Alembic's configuration for the migrations in this package, on an open connection."""
    config = Config()
    config.set_main_option("script_location", str(MIGRATIONS).replace("%", "%%"))
    config.set_main_option("path_separator", "os")
    config.attributes["connection"] = connection
    return config
