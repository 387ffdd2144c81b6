"""PostgreSQL by psycopg 3: the store on a server, which may be unavailable at any time.

Writers are serialised by one advisory lock of the database, as by the lock of SQLite's file. Therefore the chain of the
audit has no fork, the outbox is in order, and no writer reads rows that another one changes.
"""

from collections.abc import Sequence
from typing import Any

from sqlalchemy import URL, Connection, Engine, Table, create_engine, event, func, select
from sqlalchemy.engine import ExceptionContext
from sqlalchemy.exc import DBAPIError, OperationalError
from sqlalchemy.pool import ConnectionPoolEntry

from service.model.errors import BadInput, SweepidError
from service.store.engines.kind import BUSY_TIMEOUT, PATIENCE, WRITE

_WRITERS = 0x73776565706964  # the lock's number: "sweepid"
_IDLE = 60_000  # ms of inactivity of a writer, e.g. after a power failure, until the next one may write
_AWAY = ("08", "57P")  # classes of SQLSTATE: no connection; the server stops, crashed or starts
_CONNECTING: dict[str, str | int] = {
    "connect_timeout": 5,  # s
    "target_session_attrs": "read-write",  # no standby
    "application_name": "sweepid",
    # a server whose computer has failed does not answer: detected within about 15 s
    "keepalives_idle": 5,
    "keepalives_interval": 3,
    "keepalives_count": 3,
    "tcp_user_timeout": 15_000,
}
_SESSION = (
    # the server detects a lost client in the same time, because it may hold the writers' lock
    "SET tcp_keepalives_idle = 5",
    "SET tcp_keepalives_interval = 3",
    "SET tcp_keepalives_count = 3",
    f"SET idle_in_transaction_session_timeout = {_IDLE}",
    # committed data is on disk, whatever the default of the server
    "SELECT set_config('synchronous_commit', 'on', false) WHERE current_setting('synchronous_commit') = 'off'",
)


class NotReached(SweepidError):
    """The server of the database does not answer or refuses the login (exit code 1)."""


class Postgresql:
    """`Kind` for PostgreSQL."""

    def __init__(self, url: URL, password: str | None = None) -> None:
        """`password`: None if libpq finds it (``PGPASSFILE``), or none is needed."""
        self._url, self._password = url, password

    def engine(self) -> Engine:
        secret: dict[str, Any] = {} if self._password is None else {"password": self._password}
        try:
            # pre_ping: a connection that the server closed meanwhile is opened again before use
            engine = create_engine(self._url, pool_pre_ping=True, connect_args={**_CONNECTING, **secret})
        except ModuleNotFoundError as error:
            reason = f"PostgreSQL needs {error.name}: install sweepid with its extra, `sweepid[postgresql]`"
            raise BadInput("database_url", reason) from None
        event.listen(engine, "connect", _configure)
        event.listen(engine, "begin", _begin)
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
        return state is None or str(state).startswith(_AWAY)

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


def _configure(connection: Any, _: ConnectionPoolEntry) -> None:
    from psycopg.types.string import StrDumper

    class NoNul(StrDumper):
        """PostgreSQL does not support NUL in text; input of people and drives may contain one."""

        def dump(self, obj: str) -> Any:
            return super().dump(obj.replace("\0", "\N{REPLACEMENT CHARACTER}"))

    connection.adapters.register_dumper(str, NoNul)
    with connection.cursor() as cursor:
        for statement in _SESSION:
            cursor.execute(statement)
    connection.commit()


def _begin(connection: Connection) -> None:
    options = connection.get_execution_options()
    if not options.get(WRITE, False):
        connection.exec_driver_sql("SET TRANSACTION ISOLATION LEVEL REPEATABLE READ READ ONLY")
        return
    # READ COMMITTED: each statement after the lock sees the commit of the previous writer
    connection.exec_driver_sql("SET TRANSACTION ISOLATION LEVEL READ COMMITTED READ WRITE")
    connection.exec_driver_sql(f"SET LOCAL lock_timeout = {int(options.get(PATIENCE, BUSY_TIMEOUT) * 1000)}")
    connection.exec_driver_sql(f"SELECT pg_advisory_xact_lock({_WRITERS})")
    connection.info["transaction"] = connection.exec_driver_sql("SELECT pg_current_xact_id()::text").scalar_one()


def _as_operational(context: ExceptionContext) -> None:
    """A lost connection is the same error whichever class the driver raises."""
    raised = context.sqlalchemy_exception
    if context.is_disconnect and raised is not None and not isinstance(raised, OperationalError):
        raise OperationalError(context.statement, None, context.original_exception, connection_invalidated=True)
