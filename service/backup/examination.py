"""What is wrong with a data folder and its database. Nothing is written, migrated or repaired."""

import json
import os
import sqlite3
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from service.backup.making import check_owner
from service.errors import BadInput
from service.store.files.data_folder import FILE as OWNER
from service.store.files.recordings import RecordingFiles, file_sha256
from service.store.snapshot import Contents, contents, integrity, known_schemas, look

_PUT_ASIDE = (".unknown", ".unreadable")


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is wrong, and what to do."""

    place: str
    what: str
    action: str

    @property
    def line(self) -> str:
        return " ".join(f"{self.place}: {self.what}; {self.action}".split())


def examine(database: Path, data_dir: Path, least_free: int) -> tuple[Finding, ...]:
    """All findings, the database's first. `least_free`: bytes that the disk should have. Every file is read."""
    found = [*_folder(data_dir, least_free)]
    there = list(_files(data_dir))  # before the rows: what comes while we look is then named by them
    try:
        named = look(database, contents)
        wrong = look(database, integrity)
    except BadInput as error:
        reason = error.reason if error.place == str(database) else str(error)
        return *found, Finding(str(database), reason, "restore a backup, or use the sweepid that wrote it")
    except (sqlite3.Error, OSError) as error:
        return *found, Finding(str(database), f"cannot be read: {error}", "restore a backup")
    found += [*_database(database, named, wrong), *_owner(data_dir, named), *_named(data_dir, named)]
    unknown = [path for path in there if _nobodys(path, database, data_dir, named)]
    if unknown:  # a second look, at those that are still there: a service may just have stored them
        named = look(database, contents)
        unknown = [path for path in unknown if path.exists() and _nobodys(path, database, data_dir, named)]
    return *found, *(Finding(str(path), *_told(path, data_dir)) for path in unknown)


def _folder(data_dir: Path, least_free: int) -> Iterator[Finding]:
    if trouble := RecordingFiles(data_dir).disk_trouble(least_free):
        yield Finding(str(data_dir), trouble, "make room, or put permissions right")
    for folder in sorted((data_dir / "recordings").glob("*/")):
        if not os.access(folder, os.R_OK | os.W_OK | os.X_OK):
            yield Finding(str(folder), "this user cannot read and write it", "put owner and permissions right")


def _database(place: Path, named: Contents, wrong: list[str]) -> Iterator[Finding]:
    if not os.access(place, os.R_OK | os.W_OK):
        yield Finding(str(place), "this user cannot read and write it", "put owner and permissions right")
    for line in wrong:
        yield Finding(str(place), line, "restore a backup")
    newest = known_schemas()[-1]
    if named.schema != newest:
        told = f"has schema {named.schema}, this sweepid's is {newest}"
        yield Finding(str(place), told, "make a backup; the next start of the service migrates it")


def _owner(data_dir: Path, named: Contents) -> Iterator[Finding]:
    try:
        check_owner(data_dir, named)
    except OSError as error:
        yield Finding(str(data_dir / OWNER), f"cannot be read: {error}", "put owner and permissions right")
    except BadInput as error:
        yield Finding(
            error.place, error.reason, "bring folder and database of one service together, or restore a backup"
        )


def _named(data_dir: Path, named: Contents) -> Iterator[Finding]:
    for path, sha256 in named.files.items():
        if what := _file(data_dir / path, sha256):
            yield Finding(str(data_dir / path), what, f"copy data/{path} of a backup there")


def _file(path: Path, sha256: str | None) -> str:
    """What is wrong with a file of this hash, or with a manifest beside a recording; empty if nothing is."""
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


def _nobodys(path: Path, database: Path, data_dir: Path, named: Contents) -> bool:
    """Whether neither rows nor database explain a file. What a service has under way is explained while one runs."""
    within = path.relative_to(data_dir)
    parts = (database.name + end for end in ("", "-wal", "-shm", "-journal"))
    of_database = path.parent.resolve() == database.parent.resolve() and path.name in parts
    if of_database or within.as_posix() in (OWNER, *named.files):
        return False
    under_way = path.suffix == ".arrows" or within.parts[0] == "transfer"
    return not (named.held_by and under_way)


def _told(path: Path, data_dir: Path) -> tuple[str, str]:
    """What a file is that nobody names, and what to do."""
    if any(end in path.name for end in _PUT_ASIDE):
        return "a stream that the service put aside, because it makes no recording", "look at it, then move it away"
    if path.suffix == ".arrows" or path.relative_to(data_dir).parts[0] == "transfer":
        return "was left by a service that was killed", "its next start takes it in or removes it"
    return "no row of the database names it", "move it away if nobody needs it"
