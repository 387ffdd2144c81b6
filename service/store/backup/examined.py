"""A database as examined by `doctor`: a SQLite file, or a server. Nothing is written or migrated."""

import os
import sqlite3
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Protocol, TypeVar

from sqlalchemy import Connection, inspect
from sqlalchemy.exc import SQLAlchemyError

from service.model.errors import BadInput
from service.store.database import refusal
from service.store.engines.address import kind_of, parsed_url
from service.store.engines.postgresql import NotReached
from service.store.snapshot import Contents, contents, contents_of, integrity, look, sqlite_file

RESTORE = "restore a backup"
_TRIGGERS = (
    "SELECT count(*) FROM pg_trigger "
    "WHERE tgrelid = to_regclass('audit') AND left(tgname, 9) = 'audit_no_' AND tgenabled = 'O'"
)
_FAILURES = "SELECT coalesce(checksum_failures, 0) FROM pg_stat_database WHERE datname = current_database()"
_SQLITE_TRIGGERS = (
    "SELECT count(*) FROM sqlite_master WHERE type = 'trigger' "
    "AND tbl_name = 'audit' AND substr(name, 1, 9) = 'audit_no_'"
)
_UNPROTECTED = (
    "the triggers that protect the audit against changes are missing or disabled",
    "run `sweepid audit verify`, then restore a backup if needed",
)

Result = TypeVar("Result")


class Unreadable(Exception):
    """Reason why the database cannot be read, and what to do."""

    def __init__(self, what: str, action: str) -> None:
        super().__init__(what)
        self.what, self.action = what, action


class Examined(Protocol):
    """Each method raises Unreadable."""

    @property
    def place(self) -> str: ...

    @property
    def file(self) -> Path | None: ...

    def contents(self) -> Contents: ...

    def wrong(self) -> list[tuple[str, str]]:
        """Errors of the database itself, each with what to do."""
        ...


class SqliteFile:
    def __init__(self, file: Path) -> None:
        self.file, self.place = file, str(file)

    def contents(self) -> Contents:
        return self._look(contents)

    def wrong(self) -> list[tuple[str, str]]:
        found = [(line, RESTORE) for line in self._look(integrity)] + self._look(_unprotected)
        if not os.access(self.file, os.R_OK | os.W_OK):
            found.insert(0, ("this user cannot read and write it", "put owner and permissions right"))
        return found

    def _look(self, read: Callable[[sqlite3.Connection], Result]) -> Result:
        try:
            return look(self.file, read)
        except BadInput as error:
            reason = error.reason if error.place == self.place else str(error)
            raise Unreadable(reason, f"{RESTORE}, or use the sweepid that wrote it") from None
        except (sqlite3.Error, OSError) as error:
            raise Unreadable(f"cannot be read: {error}", RESTORE) from None


class Server:
    file = None

    def __init__(self, url: str, password_file: Path | None) -> None:
        self._kind = kind_of(url, password_file)
        self.place = parsed_url(url).render_as_string(hide_password=True)

    def contents(self) -> Contents:
        return self._look(_contents)

    def wrong(self) -> list[tuple[str, str]]:
        return self._look(lambda connection: list(_wrong(connection)))

    def _look(self, read: Callable[[Connection], Result]) -> Result:
        engine = self._kind.engine()
        try:
            self._kind.check(engine)
            with engine.connect() as connection:
                return read(connection)
        except BadInput as error:
            raise Unreadable(error.reason, "use the sweepid that wrote it") from None
        except NotReached as error:
            raise Unreadable(str(error).removeprefix(f"{self.place}: "), "look at the server's log") from None
        except SQLAlchemyError as error:
            raise Unreadable(refusal(error), "look at the server's log") from None
        finally:
            engine.dispose()


def examined(url: str, password_file: Path | None = None) -> SqliteFile | Server:
    """The database at a URL."""
    if parsed_url(url).get_backend_name() == "sqlite":
        return SqliteFile(sqlite_file(url))
    return Server(url, password_file)


def _contents(connection: Connection) -> Contents:
    def rows(statement: str) -> list[tuple[str, ...]]:
        return [tuple(row) for row in connection.exec_driver_sql(statement)]

    return contents_of(set(inspect(connection).get_table_names()), rows)


def _wrong(connection: Connection) -> Iterator[tuple[str, str]]:
    for setting in ("fsync", "full_page_writes"):
        if connection.exec_driver_sql(f"SHOW {setting}").scalar_one() == "off":
            yield f"{setting} is off on the server: stored data are lost on a power failure", f"set {setting} = on"
    if failures := connection.exec_driver_sql(_FAILURES).scalar():
        yield f"the server found {failures} pages whose checksum is wrong", "check the disk and restore a dump"
    if connection.exec_driver_sql(_TRIGGERS).scalar_one() != 4:
        yield _UNPROTECTED


def _unprotected(connection: sqlite3.Connection) -> list[tuple[str, str]]:
    ((found,),) = connection.execute(_SQLITE_TRIGGERS)
    return [] if found == 3 else [_UNPROTECTED]
