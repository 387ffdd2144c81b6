"""A backup of a data folder, while a service runs or not.

The database is copied first, at one instant. All files that it names then exist and do not change any more: a file is
on the disk before its row is committed, and none is overwritten or removed later, except recordings that are in the
object store. Those that are only there are listed, not fetched: the object store has its own backups.
"""

from datetime import UTC, datetime
from pathlib import Path

from service.model.errors import BadInput
from service.store.backup.building import building, copy_file
from service.store.backup.manifest import DATA, FILE, Manifest, StoredFile, inside
from service.store.files.atomic_files import sync
from service.store.files.data_folder import FILE as OWNER
from service.store.files.data_folder import read_owner
from service.store.files.recordings import RecordingFiles, file_sha256
from service.store.snapshot import Contents, contents, copy_database, look

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
        stored |= _copy_owner(data_dir, copied.parent, found)
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
            str(data_dir / OWNER), f"the data folder belongs to database {owner.id}, not to {found.identity}"
        )
    return owner is not None


def machine_of(data_dir: Path) -> int:
    """The id of the machine whose files are in a data folder; 1 if unknown. BadInput as `read_owner`."""
    owner = read_owner(data_dir)
    return 1 if owner is None else owner.machine


def _is_moved(database: Path, found: Contents, path: str) -> bool:
    """Whether the recording is in the object store: it may have been moved after the copy was made."""
    return path in found.moved or path in look(database, contents).moved


def _copy_owner(data_dir: Path, target: Path, found: Contents) -> dict[str, StoredFile]:
    return {OWNER: copy_file(data_dir / OWNER, target / OWNER)} if check_owner(data_dir, found) else {}


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
