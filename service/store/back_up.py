"""Backup of the embedded store (SQLite and data folder), and its restoration.

A backup has the layout of a data folder below ``data/``; ``manifest.json`` is written last::

    BACKUP/manifest.json
    BACKUP/data/sweepid.sqlite
    BACKUP/data/database.json
    BACKUP/data/recordings/campaign-000001/0001-1.parquet ...

The database is copied first, at one instant, while a service runs or not. All files that it names then exist and do
not change any more: a file is on the disk before its row is committed, and none is overwritten or removed later, except
recordings that are in the object store. Those that are only there are listed, not fetched: it has its own backups.

The file of a database is read from outside: it is not migrated, and no writer is blocked, because readers of a WAL do
not block. SQLite itself copies it (its backup API), never the files, because the last commits are in the WAL.
"""

import hashlib
import shutil
import sqlite3
from collections.abc import Callable, Generator, Iterable
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path, PurePosixPath
from typing import Annotated, Literal, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, StringConstraints, ValidationError

from service import BadInput, SweepidError
from service.store.database import BUSY_TIMEOUT, known_schemas, parsed_url, unknown_schema
from service.store.files.data_folder import OWNER_FILE, read_owner
from service.store.files.recordings import RecordingFiles, check_new, file_sha256, place_folder, sync

FILE = "manifest.json"
DATA = "data"


Sha256 = Annotated[str, StringConstraints(pattern="^[0-9a-f]{64}$")]


def inside(path: str) -> str:
    """`path` if it stays in the folder that it is relative to; otherwise ValueError."""
    parts = PurePosixPath(path).parts
    if not parts or "\0" in path or PurePosixPath(path).is_absolute() or ".." in parts:
        raise ValueError(f"{path!r} leads out of its folder")
    return path


class StoredFile(BaseModel):
    """Size in bytes and SHA-256 of a file."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    size: int = Field(ge=0)
    sha256: Sha256


class Manifest(BaseModel):
    """The files by path below ``data/``; `streams_left_out` were being recorded, or left by a service that crashed.

    `in_store`: SHA-256 by path of the recordings that were only in the object store. They are not in the backup.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")
    format: Literal[1] = 1
    made_at: datetime
    schema_version: str
    database: str | None
    files: dict[Annotated[str, AfterValidator(inside)], StoredFile]
    streams_left_out: tuple[str, ...]
    in_store: dict[Annotated[str, AfterValidator(inside)], Sha256] = Field(default_factory=dict)

    @property
    def size(self) -> int:
        """Bytes of all files."""
        return sum(file.size for file in self.files.values())


def read_manifest(backup: Path, largest: int = 2**26) -> Manifest:
    """BadInput for a folder that is not a backup, or not a complete one. `largest`: bytes (300,000 recordings)."""
    place = backup / FILE
    try:
        with place.open("rb") as file:
            content = file.read(largest + 1)
        if len(content) > largest:
            raise BadInput(str(place), f"is larger than {largest} bytes")
        return Manifest.model_validate_json(content)
    except (FileNotFoundError, NotADirectoryError):
        raise BadInput(str(backup), f"is not a complete backup: {FILE} is missing") from None
    except OSError as error:
        raise BadInput(str(place), f"cannot be read: {error.strerror or error}") from None
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise BadInput(str(place), f"is not the manifest of a backup: {where} {first['msg']}".rstrip()) from None


PARTIAL = ".partial"


class NotCopied(SweepidError):
    """The disk did not accept or deliver data; the incomplete copy was removed."""


@contextmanager
def building(target: Path) -> Generator[Path]:
    """A new folder next to `target` that is renamed to it at the end of the block, after all content is on the disk.

    If the block raises, the folder is removed; if the process is killed it stays, named ``.NAME.partial``. BadInput if
    such a folder exists, or the parent folder does not. NotCopied instead of OSError and sqlite3.Error.
    """
    partial = target.with_name(f".{target.name}{PARTIAL}")
    try:
        partial.mkdir()
    except FileExistsError:
        reason = "is left over from a killed run, or in use by another run: remove it if no other run is active"
        raise BadInput(str(partial), reason) from None
    except OSError as error:
        raise BadInput(str(target), f"cannot be made in {target.parent}: {error.strerror or error}") from None
    try:
        yield partial
        for folder in (path for path in partial.rglob("*") if path.is_dir()):
            sync(folder)
        sync(partial)
        place_folder(partial, target)
    except BaseException as error:
        shutil.rmtree(partial, ignore_errors=True)
        if isinstance(error, OSError | sqlite3.Error):
            raise NotCopied(f"{target} was not written: {error}") from error
        raise


def copy_file(source: Path, target: Path) -> StoredFile:
    """Copy a file into a folder, which is created if necessary; the content is on the disk at return. OSError."""
    target.parent.mkdir(parents=True, exist_ok=True)
    digest, size = hashlib.sha256(), 0
    with source.open("rb") as read, target.open("xb") as written:
        while chunk := read.read(2**20):  # bytes
            digest.update(chunk)
            size += written.write(chunk)
    sync(target)
    return StoredFile(size=size, sha256=digest.hexdigest())


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
    """One consistent state of the database as a separate file, without a WAL. sqlite3.Error if the disk is full."""

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
        query = (
            f"SELECT file.path, campaign.machine_id FROM {table} AS file JOIN sweep ON sweep.id = file.sweep_id "
            "JOIN campaign ON campaign.id = sweep.campaign_id WHERE campaign.machine_id <> 1"
        )
        for path, machine in rows(query):
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


DATABASE = "sweepid.sqlite"


def make_backup(database: Path, data_dir: Path, target: Path) -> Manifest:
    """Copy `database` and all files of `data_dir` that it names to `target`, a folder that does not exist yet.

    BadInput, and nothing is left, if `target` exists or is in the data folder, or the data folder is damaged or belongs
    to another database; NotCopied for disk errors.
    """
    target, data_dir = target.resolve(), data_dir.resolve()
    if target.exists():
        raise BadInput(str(target), "exists already; nothing is overwritten")
    if target.is_relative_to(data_dir):
        raise BadInput(str(target), f"is inside the data folder {data_dir}: choose a folder on another disk")
    files = RecordingFiles(data_dir)
    with building(target) as partial:
        under_way = files.streams()
        copied = partial / DATA / DATABASE
        copied.parent.mkdir()
        copy_database(database, copied)
        under_way |= files.streams()
        sync(copied)
        found = look(copied, contents).of_machine(machine_of(data_dir))
        stored = {DATABASE: StoredFile(size=copied.stat().st_size, sha256=file_sha256(copied))}
        if check_owner(data_dir, found):
            stored[OWNER_FILE] = copy_file(data_dir / OWNER_FILE, copied.parent / OWNER_FILE)
        in_store: dict[str, str] = {}
        for path, sha256 in found.files.items():
            if sha256 is not None and not (data_dir / path).exists() and _is_moved(database, found, path):
                in_store[path] = sha256
            elif sha256 is not None or (data_dir / path).exists():
                stored[path] = _copy_named(data_dir, copied.parent, path, sha256)
        streams = (path.relative_to(data_dir) for path in under_way.values())
        manifest = Manifest(
            made_at=datetime.now(UTC),
            schema_version=found.schema,
            database=found.identity,
            files=stored,
            streams_left_out=tuple(
                sorted(path.as_posix() for path in streams if str(path.with_suffix(".parquet")) not in found.files)
            ),
            in_store=in_store,
        )
        (partial / FILE).write_text(manifest.model_dump_json(indent=2) + "\n", encoding="utf-8")
        sync(partial / FILE)
    return manifest


def check_owner(data_dir: Path, found: Contents) -> bool:
    """Whether the data folder belongs to this database; BadInput if to another, False if unknown."""
    owner = read_owner(data_dir)
    if owner is not None and owner.id != found.identity:
        raise BadInput(
            str(data_dir / OWNER_FILE), f"the data folder belongs to database {owner.id}, not to {found.identity}"
        )
    return owner is not None


def machine_of(data_dir: Path) -> int:
    """The id of the machine whose files are in a data folder; 1 if unknown. BadInput as `read_owner`."""
    owner = read_owner(data_dir)
    return 1 if owner is None else owner.machine


def _is_moved(database: Path, found: Contents, path: str) -> bool:
    """Whether the recording is in the object store: it may have been moved after the copy was made."""
    return path in found.moved or path in look(database, contents).moved


def _copy_named(data_dir: Path, target: Path, path: str, sha256: str | None) -> StoredFile:
    """Copy one file; BadInput if it does not match its row."""
    try:
        inside(path)
        stored = copy_file(data_dir / path, target / path)
    except ValueError as error:
        raise BadInput("database", f"names a file outside of the data folder: {error}") from None
    except FileNotFoundError:
        raise BadInput(str(data_dir / path), "is missing; `sweepid data doctor` lists all problems") from None
    if sha256 not in (None, stored.sha256):
        reason = f"was changed, SHA-256 is not {sha256}; `sweepid data doctor` lists all problems"
        raise BadInput(str(data_dir / path), reason)
    return stored


def check_backup(backup: Path) -> Manifest:
    """The manifest of a complete backup; otherwise BadInput names the first error."""
    if backup.name.endswith(PARTIAL):
        raise BadInput(str(backup), "is not a complete backup: it was not finished")
    manifest = read_manifest(backup)
    for path, stored in manifest.files.items():
        _check_file(backup / DATA / path, stored)
    place = backup / DATA / DATABASE
    if DATABASE not in manifest.files:
        raise BadInput(str(place), "is not in the manifest")
    try:
        found = look(place, contents)
        wrong = look(place, integrity)
    except sqlite3.Error as error:
        raise BadInput(str(place), f"is not a complete database: {error}") from None
    if wrong:
        raise BadInput(str(place), f"is not a complete database: {wrong[0]}")
    _compare(backup, manifest, found)
    return manifest


def restore(backup: Path, data_dir: Path) -> Manifest:
    """Make `data_dir`, which is new or empty, from a backup, after the complete backup was verified.

    BadInput, and nothing is left, otherwise; NotCopied for disk errors.
    """
    backup, data_dir = backup.resolve(), data_dir.resolve()
    check_new(data_dir)
    if data_dir.is_mount():
        raise BadInput(str(data_dir), "is a mount point and cannot be replaced: give a new folder in it")
    manifest = check_backup(backup)
    with building(data_dir) as partial:
        for path, stored in manifest.files.items():
            if copy_file(backup / DATA / path, partial / path) != stored:
                raise NotCopied(f"{backup / DATA / path} changed while it was read: check the disk")
    return manifest


def _check_file(path: Path, stored: StoredFile) -> None:
    try:
        size = path.stat().st_size
        same = size == stored.size and file_sha256(path) == stored.sha256
    except FileNotFoundError:
        raise BadInput(str(path), "is missing: the backup is not complete") from None
    except OSError as error:
        raise BadInput(str(path), f"cannot be read: {error.strerror or error}") from None
    if not same:
        difference = (
            f"{size} bytes instead of {stored.size}" if size != stored.size else f"SHA-256 is not {stored.sha256}"
        )
        raise BadInput(str(path), f"was changed, {difference}: the backup is not complete")


def _compare(backup: Path, manifest: Manifest, found: Contents) -> None:
    """BadInput if database and manifest belong to different backups."""
    check_owner(backup / DATA, found)
    if (found.schema, found.identity) != (manifest.schema_version, manifest.database):
        raise BadInput(
            str(backup), f"the manifest names database {manifest.database}, schema {manifest.schema_version}; the "
                f"backup contains database {found.identity}, schema {found.schema}"
        )  # fmt: skip
    for path, sha256 in found.files.items():
        there = manifest.files[path].sha256 if path in manifest.files else manifest.in_store.get(path)
        if sha256 not in (None, there):
            raise BadInput(
                str(backup), f"{path} is used by the database, but is missing in the manifest or different there"
            )
