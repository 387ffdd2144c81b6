"""Reads the file of a SQLite database from outside, with or without a running service.

It is not migrated, and no writer is blocked: readers of a WAL do not block. A copy is made by SQLite
itself (its backup API), never from the files, because the last commits are in the WAL.
"""

import sqlite3
from collections.abc import Callable, Iterable
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import TypeVar

from service.model.errors import BadInput
from service.store.database import known_schemas, unknown_schema
from service.store.engines.address import parsed_url
from service.store.engines.kind import BUSY_TIMEOUT

_OF_MACHINE = (
    "SELECT file.path, campaign.machine_id FROM {table} AS file JOIN sweep ON sweep.id = file.sweep_id "
    "JOIN campaign ON campaign.id = sweep.campaign_id WHERE campaign.machine_id <> 1"
)

Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class Contents:
    """Metadata of a database, and the files in its data folder."""

    schema: str
    identity: str
    files: dict[str, str | None]
    """SHA-256 by path, relative to the data folder; None for the manifest of a recording, which is in no row."""
    moved: frozenset[str]
    """Paths of the recordings that are in the object store, and possibly only there."""
    held_by: str
    """Holder of the machine: a service that runs or was killed; empty: none."""
    machines: dict[str, int]
    """The machine of each file by its path, if it is not 1."""

    def of_machine(self, machine: int) -> "Contents":
        """With the files of this machine only: those of the others are in their own data folders."""
        mine = {path: value for path, value in self.files.items() if self.machines.get(path, 1) == machine}
        return replace(self, files=mine)


def sqlite_file(url: str) -> Path:
    """The file of the database at `url`. Raises BadInput if it is not SQLite."""
    parsed = parsed_url(url)
    if parsed.get_backend_name() != "sqlite" or not parsed.database or parsed.database == ":memory:":
        shown = parsed.render_as_string(hide_password=True)
        raise BadInput(
            "database_url",
            f"{shown} is not a SQLite file: back up a PostgreSQL database with pg_dump, then copy the "
            "data folder (docs/how-to/use-postgresql.md)",
        )
    return Path(parsed.database)


def look(place: Path, read: Callable[[sqlite3.Connection], Result]) -> Result:
    """Result of `read` on one consistent state of the database at `place`; no file is written or left.

    Raises BadInput if there is none; sqlite3.Error of `read`, also for a file that is no database.
    """
    if not place.is_file():
        raise BadInput(str(place), "database is missing")
    while True:
        before = _state(place)
        # no process has it open: a plain reader would leave an empty WAL
        alone = not any(before[1:])
        with closing(_connect(place, "&immutable=1" if alone else "")) as connection:
            connection.execute("BEGIN")
            result = read(connection)
        if not alone or _state(place) == before:
            return result


def copy_database(place: Path, target: Path) -> None:
    """One consistent state of the database as a separate file, without a WAL. Raises sqlite3.Error if the disk
    is full.
    """

    def copy(source: sqlite3.Connection) -> None:
        with closing(sqlite3.connect(target, isolation_level=None)) as copied:
            source.backup(copied)  # in one step: otherwise each commit of the service restarts it
            copied.execute("PRAGMA journal_mode = DELETE")

    look(place, copy)


def contents(connection: sqlite3.Connection) -> Contents:
    """Contents of a database. Raises BadInput for one of another schema and for a foreign database."""
    tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    return contents_of(tables, connection.execute)


def contents_of(tables: set[str], rows: Callable[[str], Iterable[tuple[str, ...]]]) -> Contents:
    """As `contents`, of a database with these tables; `rows` returns those of a statement."""
    if not {"alembic_version", "recording"} <= tables:
        raise BadInput("database", "is not a database of sweepid")
    ((schema,),) = rows("SELECT version_num FROM alembic_version")
    if schema not in known_schemas():
        raise BadInput("database", unknown_schema(schema))
    files: dict[str, str | None] = {}
    samples = {path for (path,) in rows("SELECT path FROM recording WHERE pruned_at IS NULL")}
    moved = {path for (path,) in rows("SELECT path FROM recording WHERE moved_at IS NOT NULL")}
    for path, sha256 in rows("SELECT path, sha256 FROM recording ORDER BY path"):
        if path in samples:
            files[path] = sha256
        files[str(PurePosixPath(path).with_suffix(".json"))] = None
    files.update((path, sha256) for path, sha256 in rows("SELECT path, sha256 FROM spectrum_file ORDER BY path"))
    machines: dict[str, int] = {}
    for table in ("recording", "spectrum_file"):
        for path, machine in rows(_OF_MACHINE.format(table=table)):
            machines[path] = machines[str(PurePosixPath(path).with_suffix(".json"))] = int(machine)
    ((identity,),) = rows("SELECT id FROM identity")
    held_by = ", ".join(owner for (owner,) in rows("SELECT owner FROM lease"))
    return Contents(schema, identity, files, frozenset(moved & samples), held_by, machines)


def integrity(connection: sqlite3.Connection) -> list[str]:
    """What SQLite finds wrong with the file and with the references between its rows."""
    found = [line for (line,) in connection.execute("PRAGMA integrity_check") if line != "ok"]
    return found + [
        f"row {row} of {table} refers to a {parent} that does not exist"
        for table, row, parent, _ in connection.execute("PRAGMA foreign_key_check")
    ]


def _state(place: Path) -> tuple[object, ...]:
    """Size and time of the file, and whether somebody has it open (or died with it)."""
    now = place.stat()
    return (now.st_size, now.st_mtime_ns, now.st_ino), *(
        place.with_name(place.name + end).exists() for end in ("-wal", "-journal")
    )


def _connect(place: Path, more: str) -> sqlite3.Connection:
    return sqlite3.connect(
        f"{place.absolute().as_uri()}?mode=ro{more}", uri=True, isolation_level=None, timeout=BUSY_TIMEOUT
    )
