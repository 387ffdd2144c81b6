"""Finds errors in a data folder and its database, SQLite or a server. Nothing is written, migrated or repaired."""

import json
import os
import sqlite3
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from sqlalchemy import Connection, inspect
from sqlalchemy.exc import SQLAlchemyError

from service import BadInput
from service.process.settings import AUDIT_HEADS, StoreAddress
from service.store.back_up import Contents, check_owner, contents, contents_of, integrity, look, machine_of, sqlite_file
from service.store.database import NotReached, kind_of, parsed_url, refusal
from service.store.files.data_folder import OWNER_FILE
from service.store.files.recordings import RecordingFiles, file_sha256
from service.store.objects import MissingObject, ObjectStore, StoreAway, WrongObject

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


class SqliteFile:
    """A database to be examined. Each method raises Unreadable."""

    mend = "restore a backup"

    def __init__(self, file: Path) -> None:
        self.file, self.place = file, str(file)

    def contents(self) -> Contents:
        return self._look(contents)

    def wrong(self) -> list[tuple[str, str]]:
        """Errors of the database itself, each with what to do."""
        found = [(line, SqliteFile.mend) for line in self._look(integrity)] + self._look(_unprotected)
        if not os.access(self.file, os.R_OK | os.W_OK):
            found.insert(0, ("this user cannot read and write it", "put owner and permissions right"))
        return found

    def _look(self, read: Callable[[sqlite3.Connection], Result]) -> Result:
        try:
            return look(self.file, read)
        except BadInput as error:
            reason = error.reason if error.place == self.place else str(error)
            raise Unreadable(reason, f"{SqliteFile.mend}, or use the sweepid that wrote it") from None
        except (sqlite3.Error, OSError) as error:
            raise Unreadable(f"cannot be read: {error}", SqliteFile.mend) from None


class ServerDatabase:
    """As `SqliteFile`."""

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


def examined(url: str, password_file: Path | None = None) -> SqliteFile | ServerDatabase:
    """The database at a URL."""
    if parsed_url(url).get_backend_name() == "sqlite":
        return SqliteFile(sqlite_file(url))
    return ServerDatabase(url, password_file)


def _contents(connection: Connection) -> Contents:
    tables = set(inspect(connection).get_table_names())
    return contents_of(tables, lambda statement: [tuple(row) for row in connection.exec_driver_sql(statement)])


def _wrong(connection: Connection) -> Iterator[tuple[str, str]]:
    for setting in ("fsync", "full_page_writes"):
        if connection.exec_driver_sql(f"SHOW {setting}").scalar_one() == "off":
            yield f"{setting} is off on the server: stored data are lost on a power failure", f"set {setting} = on"
    failed = connection.exec_driver_sql(
        "SELECT coalesce(checksum_failures, 0) FROM pg_stat_database WHERE datname = current_database()"
    )
    if failures := failed.scalar():
        yield f"the server found {failures} pages whose checksum is wrong", "check the disk and restore a dump"
    triggers = connection.exec_driver_sql(
        "SELECT count(*) FROM pg_trigger "
        "WHERE tgrelid = to_regclass('audit') AND left(tgname, 9) = 'audit_no_' AND tgenabled = 'O'"
    )
    if triggers.scalar_one() != 4:
        yield _UNPROTECTED


def _unprotected(connection: sqlite3.Connection) -> list[tuple[str, str]]:
    ((found,),) = connection.execute(
        "SELECT count(*) FROM sqlite_master WHERE type = 'trigger' "
        "AND tbl_name = 'audit' AND substr(name, 1, 9) = 'audit_no_'"
    )
    return [] if found == 3 else [_UNPROTECTED]


@dataclass(frozen=True, slots=True)
class Defect:
    """One error, and what to do."""

    place: str
    what: str
    action: str

    @property
    def line(self) -> str:
        return " ".join(f"{self.place}: {self.what}; {self.action}".split())


def examine(
    database: Path | SqliteFile | ServerDatabase, data_dir: Path, least_free: int, store: StoreAddress | None = None
) -> tuple[Defect, ...]:
    """All findings, the database's first. `least_free`: bytes that should be free on the disk. Every file is read.

    Each object in `store` that the database names is read too; missing recordings are searched there.
    """
    if isinstance(database, Path):
        database = SqliteFile(database)
    found = [*_folder(data_dir, least_free)]
    there = list(_files(data_dir))  # before the rows: files written meanwhile then have a row
    try:
        named, wrong = database.contents().of_machine(_machine(data_dir)), database.wrong()
    except Unreadable as error:
        return *found, Defect(database.place, error.what, error.action)
    found += [
        *(Defect(database.place, line, action) for line, action in wrong),
        *_owner(data_dir, named),
        *_named(data_dir, named),
    ]
    found += objects_wrong(data_dir, named, store)
    unknown = [path for path in there if _nobodys(path, database.file, data_dir, named)]
    if unknown:  # check again those that still exist: a service may just have stored them
        named = database.contents().of_machine(_machine(data_dir))
        unknown = [path for path in unknown if path.exists() and _nobodys(path, database.file, data_dir, named)]
    return *found, *(Defect(str(path), *_unknown_file(path, data_dir)) for path in unknown)


def _machine(data_dir: Path) -> int:
    try:
        return machine_of(data_dir)
    except (OSError, BadInput):  # `_owner` reports it
        return 1


def _folder(data_dir: Path, least_free: int) -> Iterator[Defect]:
    if trouble := RecordingFiles(data_dir).disk_trouble(least_free):
        yield Defect(str(data_dir), trouble, "make room, or put permissions right")
    for folder in sorted((data_dir / "recordings").glob("*/")):
        if not os.access(folder, os.R_OK | os.W_OK | os.X_OK):
            yield Defect(str(folder), "this user cannot read and write it", "put owner and permissions right")


def _owner(data_dir: Path, named: Contents) -> Iterator[Defect]:
    try:
        check_owner(data_dir, named)
    except OSError as error:
        yield Defect(str(data_dir / OWNER_FILE), f"cannot be read: {error}", "put owner and permissions right")
    except BadInput as error:
        yield Defect(
            error.place, error.reason, "bring folder and database of one service together, or restore a backup"
        )


def _named(data_dir: Path, named: Contents) -> Iterator[Defect]:
    for path, sha256 in named.files.items():
        if sha256 is not None and is_recording(path) and not (data_dir / path).exists():
            continue  # `objects_wrong` reports it, because it may be, or arrive, in the object store
        if what := _file(data_dir / path, sha256):
            yield Defect(str(data_dir / path), what, f"copy data/{path} of a backup there")


def _file(path: Path, sha256: str | None) -> str:
    """The error of a file with this hash, or of a manifest next to a recording; empty if there is none."""
    try:
        if sha256 is not None:
            return "" if file_sha256(path) == sha256 else f"was changed, SHA-256 is not {sha256}"
        return "" if isinstance(json.loads(path.read_bytes()), dict) else "is not a JSON object"
    except FileNotFoundError:
        return "is missing"
    except ValueError as error:
        return f"is not a JSON object: {error}"
    except OSError as error:
        return f"cannot be read: {error.strerror or error}"


def _files(data_dir: Path) -> Iterator[Path]:
    for folder, _, names in os.walk(data_dir):
        yield from (Path(folder, name) for name in sorted(names))


def _nobodys(path: Path, database: Path | None, data_dir: Path, named: Contents) -> bool:
    """Whether neither rows nor database explain a file. While a service runs, its unfinished files are explained."""
    within = path.relative_to(data_dir)
    if database is not None:
        parts = (database.name + end for end in ("", "-wal", "-shm", "-journal"))
        if path.parent.resolve() == database.parent.resolve() and path.name in parts:
            return False
    if within.as_posix() in (OWNER_FILE, AUDIT_HEADS, *named.files):
        return False
    under_way = path.suffix == ".arrows" or within.parts[0] == "transfer"
    return not (named.held_by and under_way)


def _unknown_file(path: Path, data_dir: Path) -> tuple[str, str]:
    """Description of a file without a row, and what to do."""
    if any(end in path.name for end in (".unknown", ".unreadable")):
        return (
            "a stream that the service set aside, because it contains no complete recording",
            "look at it, then move it away",
        )
    if path.suffix == ".arrows" or path.relative_to(data_dir).parts[0] == "transfer":
        return "left over from a service process that was killed", "its next start takes it in or removes it"
    return "not referenced by the database", "move it away if nobody needs it"


def objects_wrong(data_dir: Path, named: Contents, store: StoreAddress | None) -> Iterator[Defect]:
    """Errors of recordings that were moved or are missing here. Every object is read."""
    asked: dict[str, str] = {}
    for path, sha256 in named.files.items():
        if sha256 is None or not is_recording(path):
            continue
        here = (data_dir / path).exists()
        if not here and store is None and path not in named.moved:
            yield Defect(str(data_dir / path), "is missing", f"copy data/{path} of a backup there")
        elif not here or path in named.moved:
            asked[path] = sha256
    if not asked:
        return
    if store is None:
        what = f"{len(asked)} recordings are in an object store, but none is configured"
        yield Defect(str(data_dir), what, "set `recordings_url`")
        return
    try:
        objects = ObjectStore(store)
        for path, sha256 in asked.items():
            yield from _object(objects, data_dir / path, path, sha256)
    except StoreAway as error:
        yield Defect(str(error), f"{len(asked)} recordings could not be checked", "see to the store and run it again")
    except BadInput as error:
        yield Defect(error.place, error.reason, "correct the setting")


def is_recording(path: str) -> bool:
    """True for a recording; its manifest and spectrum stay in the data folder."""
    return path.endswith(".parquet")


def _object(objects: ObjectStore, file: Path, path: str, sha256: str) -> Iterator[Defect]:
    """StoreAway."""
    whole = str(file) if file.exists() else f"data/{path} of a backup"
    try:
        objects.check(sha256)
    except (MissingObject, WrongObject) as error:
        yield Defect(error.place, error.reason, f"copy {whole} there")
