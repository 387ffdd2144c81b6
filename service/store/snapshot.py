"""The file of a SQLite database as others read it, beside a service that runs or without one.

It is not migrated, and nothing is locked that a writer needs: readers of a WAL hold nobody up. A copy is made by SQLite
itself (its backup API), never of the files: what was committed last lies in the WAL.
"""

import sqlite3
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import TypeVar

from alembic.script import ScriptDirectory
from sqlalchemy import make_url

from service.errors import BadInput
from service.store.database import BUSY_TIMEOUT, MIGRATIONS

Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class Contents:
    """What a database says of itself and of the files in its data folder."""

    schema: str
    identity: str | None
    """None: from before a data folder belonged to one database."""
    files: dict[str, str | None]
    """SHA-256 by path, relative to the data folder; None for the manifest beside a recording: no row has its."""
    held_by: str
    """Who holds the machine: a service that runs or was killed; empty: nobody."""


def sqlite_file(url: str) -> Path:
    """The file of the database at `url`; BadInput where it is not SQLite's."""
    parsed = make_url(url)
    if parsed.get_backend_name() != "sqlite" or not parsed.database or parsed.database == ":memory:":
        shown = parsed.render_as_string(hide_password=True)
        raise BadInput("database_url", f"{shown} is not a SQLite file: use the backup of that database")
    return Path(parsed.database)


def known_schemas() -> tuple[str, ...]:
    """The revisions that this version can open, the newest last."""
    newest_first = ScriptDirectory(str(MIGRATIONS)).walk_revisions()
    return tuple(script.revision for script in newest_first)[::-1]


def look(place: Path, read: Callable[[sqlite3.Connection], Result]) -> Result:
    """What `read` makes of one consistent state of the database at `place`; no file is written or left.

    BadInput where there is none; sqlite3.Error as `read` meets it, for a file that is no database too.
    """
    if not place.is_file():
        raise BadInput(str(place), "database is missing")
    while True:
        before = _state(place)
        # nobody has it open: a plain reader would leave an empty WAL behind
        alone = not any(before[1:])
        with closing(_connect(place, "&immutable=1" if alone else "")) as connection:
            connection.execute("BEGIN")
            result = read(connection)
        if not alone or _state(place) == before:
            return result


def copy_database(place: Path, target: Path) -> None:
    """One consistent state of the database as a file of its own, without a WAL. sqlite3.Error if the disk is full."""

    def copy(source: sqlite3.Connection) -> None:
        with closing(sqlite3.connect(target, isolation_level=None)) as copied:
            source.backup(copied)  # in one step: with more, each commit of the service begins it anew
            copied.execute("PRAGMA journal_mode = DELETE")

    look(place, copy)


def contents(connection: sqlite3.Connection) -> Contents:
    """Of a database of any schema up to ours; BadInput for a newer one and for what is not ours."""
    tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    if not {"alembic_version", "recording"} <= tables:
        raise BadInput("database", "is not one of sweepid")
    ((schema,),) = connection.execute("SELECT version_num FROM alembic_version")
    known = known_schemas()
    if schema not in known:
        raise BadInput("database", f"has schema {schema}, the newest known here is {known[-1]}: use a newer sweepid")
    files: dict[str, str | None] = {}
    for path, sha256 in connection.execute("SELECT path, sha256 FROM recording ORDER BY path"):
        files[path] = sha256
        files[str(PurePosixPath(path).with_suffix(".json"))] = None
    if "spectrum_file" in tables:
        files |= dict(connection.execute("SELECT path, sha256 FROM spectrum_file ORDER BY path"))
    identity = None
    if "identity" in tables:
        ((identity,),) = connection.execute("SELECT id FROM identity")
    held_by = ""
    if "lease" in tables:
        held_by = ", ".join(owner for (owner,) in connection.execute("SELECT owner FROM lease"))
    return Contents(schema, identity, files, held_by)


def integrity(connection: sqlite3.Connection) -> list[str]:
    """What SQLite finds wrong with the file and with the references between its rows."""
    found = [line for (line,) in connection.execute("PRAGMA integrity_check") if line != "ok"]
    return found + [
        f"row {row} of {table} refers to a {parent} that is not there"
        for table, row, parent, _ in connection.execute("PRAGMA foreign_key_check")
    ]


def _state(place: Path) -> tuple[object, ...]:
    """Size and time of the file, and whether somebody has it open (or died with it)."""
    told = place.stat()
    return (told.st_size, told.st_mtime_ns, told.st_ino), *(
        place.with_name(place.name + end).exists() for end in ("-wal", "-journal")
    )


def _connect(place: Path, more: str) -> sqlite3.Connection:
    return sqlite3.connect(
        f"{place.absolute().as_uri()}?mode=ro{more}", uri=True, isolation_level=None, timeout=BUSY_TIMEOUT
    )
