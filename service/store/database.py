"""Opens the database: migrations, transactions. SQLite by default, PostgreSQL by URL (`engines`)."""

import threading
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from uuid import uuid4

from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Connection, Engine, Table, insert, select
from sqlalchemy.exc import DBAPIError, OperationalError, SQLAlchemyError
from sqlalchemy.orm import Session

from service.model.errors import BadInput
from service.store import tables as t
from service.store.engines import BUSY_TIMEOUT, PATIENCE_OPTION, WRITE, Sqlite, kind_of

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
    def write(self, quiet: bool = False, patience: float = BUSY_TIMEOUT) -> Generator[Session]:
        """A transaction: all or nothing, on disk at the end of the block. Then listeners are called, unless `quiet`.

        There is no other writer meanwhile. Raises OperationalError after waiting `patience` s for another writer or
        the server.
        """
        engine = self._writing
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
