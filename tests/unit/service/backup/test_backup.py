"""What a backup holds, and that what is restored of it is the same."""

import json
import shutil
import signal
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from service import BadInput
from service.process.settings import load_settings
from service.store.back_up import FILE, make_backup, read_manifest, restore, sqlite_file
from service.store.database import open_database
from service.store.examination import examine
from service.store.files.data_folder import OWNER_FILE, claim_folder
from service.store.files.recordings import RecordingFiles, SweepAttempt, file_sha256
from service.store.lease_and_latch import MachineLease
from service.store.store import Store
from tests.command import sweepid
from tests.unit.service.backup.conftest import Forks, contents

pytestmark = pytest.mark.slow


def backup_of(data: Path, target: Path) -> Path:
    make_backup(data / "sweepid.sqlite", data, target)
    return target


def test_what_is_restored_is_the_same(data: Path, tmp_path: Path) -> None:
    before = contents(data)
    backup_of(data, tmp_path / "backup")
    assert contents(data) == before  # no WAL either
    (empty := tmp_path / "restored").mkdir()
    restore(tmp_path / "backup", empty)
    after = contents(empty)
    assert after.keys() == before.keys()
    assert {name for name in after if after[name] != before[name]} <= {"sweepid.sqlite"}  # of it the header
    assert examine(empty / "sweepid.sqlite", empty, 0) == ()
    documents = []
    for folder in (data, empty):
        with open_database(f"sqlite:///{folder / 'sweepid.sqlite'}") as database:
            assert claim_folder(folder, database) == ""
            store, files = Store(database), RecordingFiles(folder)
            documents.append((store.estimates(1), store.campaigns(), store.events(0), store.sweeps(1)))
            for recording in store.recordings(1).values():
                files.named(recording)
    assert documents[0] == documents[1]


def test_what_is_committed_beside_is_in_it_or_not_at_all(data: Path, tmp_path: Path) -> None:
    """The service has the database open, its last commits lie in the WAL, and a writer is in its transaction."""
    with open_database(f"sqlite:///{data / 'sweepid.sqlite'}") as database:
        robot = Store(database).robots()[0].id
        Store(database).add_plan(robot, {"late": 1})
        assert (data / "sweepid.sqlite-wal").stat().st_size > 0
        with database.write() as session:
            session.connection().exec_driver_sql("UPDATE plan SET document = '{}'")
            backup_of(data, tmp_path / "backup")
    restore(tmp_path / "backup", tmp_path / "restored")
    with open_database(f"sqlite:///{tmp_path / 'restored' / 'sweepid.sqlite'}") as database:
        assert [plan.document for plan in Store(database).plans()] == [{"any": "document"}, {"late": 1}]


def test_streams_under_way_are_left_out_and_told(data: Path, tmp_path: Path, forks: Forks) -> None:
    RecordingFiles(data).stream(SweepAttempt(2, 1, 1)).write_bytes(b"samples")
    settings = tmp_path / "settings.yaml"
    settings.write_text(json.dumps({"data_dir": str(data)}), "utf-8")
    done = forks({"words": ["data", "backup", str(tmp_path / "backup"), "--config", str(settings)]})
    assert done["out"].startswith(f"{tmp_path / 'backup'}: 8 files, ")
    stream = "recordings/campaign-000002/0001-1.arrows"
    assert done["err"] == f"left out, still being written: {stream}\n"
    assert read_manifest(tmp_path / "backup").streams_left_out == (stream,)
    told = sweepid("data", "restore", str(tmp_path / "backup"), "--data-dir", str(tmp_path / "restored"))
    assert (told.returncode, told.stdout) == (0, f"{tmp_path / 'restored'}\n")
    assert stream in told.stderr
    assert list((tmp_path / "restored").rglob("*.arrows")) == []


def test_a_database_elsewhere_comes_back_into_its_folder(data: Path, tmp_path: Path) -> None:
    shutil.move(data / "sweepid.sqlite", tmp_path / "elsewhere.db")
    settings = tmp_path / "settings.yaml"
    url = f"sqlite:///{tmp_path / 'elsewhere.db'}"
    settings.write_text(json.dumps({"data_dir": str(data), "database_url": url, "least_free_disk": 0}), "utf-8")
    make_backup(sqlite_file(load_settings(settings).url), data, tmp_path / "backup")
    restore(tmp_path / "backup", tmp_path / "restored")
    assert sweepid("data", "doctor", "--config", str(settings)).returncode == 0
    settings.write_text(json.dumps({"data_dir": str(tmp_path / "restored"), "least_free_disk": 0}), "utf-8")
    assert sweepid("data", "doctor", "--config", str(settings)).returncode == 0
    settings.write_text(json.dumps({"database_url": "postgresql://me:secret@db/sweepid"}), "utf-8")
    told = sweepid("data", "doctor", "--config", str(settings))
    assert (told.returncode, told.stderr.count("\n")) == (2, 1)
    assert "contains a password" in told.stderr
    assert "secret" not in told.stderr
    settings.write_text(json.dumps({"database_url": "postgresql+psycopg://me@db/sweepid"}), "utf-8")
    told = sweepid("data", "backup", str(tmp_path / "another"), "--config", str(settings))
    assert (told.returncode, "with pg_dump, then copy the data folder" in told.stderr) == (2, True)
    assert "secret" not in told.stderr


def test_what_is_there_is_not_overwritten(data: Path, tmp_path: Path) -> None:
    backup_of(data, tmp_path / "backup")
    before = contents(tmp_path)
    for refused, told in (
        (lambda: backup_of(data, tmp_path / "backup"), "exists already"),
        (lambda: restore(tmp_path / "backup", data), "is not an empty folder"),
        (lambda: restore(tmp_path / "backup", data / "sweepid.sqlite"), "is not an empty folder"),
        (lambda: backup_of(data, data / "backup"), "is inside the data folder"),
        (lambda: backup_of(data, tmp_path / "not mounted" / "backup"), "No such file"),
    ):
        with pytest.raises(BadInput, match=told):
            refused()
    assert contents(tmp_path) == before


def another_owner(data: Path) -> str:
    (data / OWNER_FILE).write_text('{"id": "other", "database": "x", "machine": 1}', "utf-8")
    return OWNER_FILE


def a_path_outside(data: Path) -> str:
    with closing(sqlite3.connect(data / "sweepid.sqlite")) as database, database:
        database.execute("UPDATE recording SET path = '../../outside.parquet' WHERE id = 1")
    return "../../outside.parquet"


@pytest.mark.parametrize("damage", [another_owner, a_path_outside])
def test_a_damaged_folder_gives_no_backup(data: Path, tmp_path: Path, damage: Callable[[Path], str]) -> None:
    place = damage(data)
    with pytest.raises(BadInput) as told:
        backup_of(data, tmp_path / "backup")
    assert place in str(told.value)
    assert [path.name for path in tmp_path.iterdir()] == ["data"]


def test_a_killed_backup_is_none(data: Path, tmp_path: Path, forks: Forks) -> None:
    before = contents(data)
    words = ["data", "backup", str(tmp_path / "backup-N"), "--data-dir", str(data)]
    ended = forks({"words": words, "killed": "backup-N"})["ended"]
    *killed, last = ended
    files = len(before) + 1  # and the manifest
    assert (set(killed), last) == ({-signal.SIGKILL}, 0)
    assert len(killed) > files
    held = set()
    for number in range(1, len(killed) + 1):
        partial = tmp_path / f".backup-{number}.partial"
        assert not (tmp_path / f"backup-{number}").exists()
        held.add(len(contents(partial)) if partial.exists() else 0)
        for place in (partial, tmp_path / f"backup-{number}"):
            with pytest.raises(BadInput, match="is not a complete backup"):
                restore(place, tmp_path / "restored")
    assert held >= set(range(files))  # it was killed at each file
    with pytest.raises(BadInput, match="remove it if no other run is active"):
        make_backup(data / "sweepid.sqlite", data, tmp_path / f"backup-{len(killed)}")
    restore(tmp_path / f"backup-{len(ended)}", tmp_path / "restored")
    assert contents(data) == before


def test_a_killed_restore_leaves_no_data_folder(data: Path, tmp_path: Path, forks: Forks) -> None:
    make_backup(data / "sweepid.sqlite", data, tmp_path / "backup")
    words = ["data", "restore", str(tmp_path / "backup"), "--data-dir", str(tmp_path / "data-N")]
    ended = forks({"words": words, "killed": "data-N"})["ended"]
    assert len(ended) > len(contents(data))
    assert [number for number in range(1, len(ended) + 1) if (tmp_path / f"data-{number}").exists()] == [len(ended)]
    whole = tmp_path / f"data-{len(ended)}"
    assert examine(whole / "sweepid.sqlite", whole, 0) == ()


@pytest.mark.parametrize("command", ["backup", "restore"])
@pytest.mark.parametrize("full_at", ["sweepid.sqlite", "*.parquet"])
def test_a_full_disk_is_one_error_and_leaves_nothing(
    data: Path, tmp_path: Path, forks: Forks, command: str, full_at: str
) -> None:
    database, recording = (min(path.stat().st_size for path in data.rglob(name)) for name in ("*.sqlite", "*.parquet"))
    assert database < recording
    limit = {"sweepid.sqlite": database, "*.parquet": recording}[full_at] - 1
    words = ["data", "backup", str(tmp_path / "new"), "--data-dir", str(data)]
    if command == "restore":
        make_backup(data / "sweepid.sqlite", data, tmp_path / "backup")
        words = ["data", "restore", str(tmp_path / "backup"), "--data-dir", str(tmp_path / "new")]
    before = contents(tmp_path)
    told = forks({"words": words, "limit": limit})
    assert (told["ended"], told["out"], told["err"].count("\n")) == ([1], "", 1)
    assert f"{tmp_path / 'new'} was not written: " in told["err"]
    assert contents(tmp_path) == before
    assert not [path for path in tmp_path.iterdir() if "new" in path.name]


Findings = Callable[[], list[tuple[str, str]]]
DAMAGES = {
    "missing": ("is missing", Path.unlink),
    "truncated": ("changed", lambda path: path.write_bytes(path.read_bytes()[:-100])),
    "corrupted": ("changed", lambda path: path.write_bytes(path.read_bytes()[:-1] + b"\0")),
    "replaced": ("cannot be read", lambda path: (path.unlink(), path.mkdir())),
}


@pytest.fixture
def backup(data: Path, tmp_path: Path) -> Path:
    make_backup(data / "sweepid.sqlite", data, tmp_path / "backup")
    return tmp_path / "backup"


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("kind", ["0001-1.parquet", "0001-1.spectrum-*.json", "0001-1.json"])
def test_a_damaged_file_is_found_and_refused(
    data: Path, backup: Path, tmp_path: Path, findings: Findings, kind: str, damage: str
) -> None:
    said, inflict = DAMAGES[damage]
    (place,) = (path.relative_to(data) for path in data.glob(f"recordings/*/{kind}"))
    for folder in (data, backup / "data"):
        inflict(folder / place)
    ((found, what),) = findings()
    assert found == place.as_posix()
    assert said in what or kind == "0001-1.json"
    before = contents(tmp_path)
    if kind != "0001-1.json" and damage != "replaced":
        with pytest.raises(BadInput, match=place.name):
            backup_of(data, tmp_path / "another")
    with pytest.raises(BadInput, match=place.name):
        restore(backup, tmp_path / "restored")
    assert contents(tmp_path) == before
    told = sweepid("data", "doctor", "--data-dir", str(data))
    assert (told.returncode, told.stdout.count("\n"), told.stderr) == (1, 1, "")
    assert f"copy data/{place.as_posix()} of a backup there" in told.stdout


@pytest.mark.parametrize("trigger", ["audit_no_update", "audit_no_delete", "audit_no_replace"])
def test_an_audit_without_its_protection_is_found(data: Path, findings: Findings, trigger: str) -> None:
    with closing(sqlite3.connect(data / "sweepid.sqlite")) as database:
        database.execute(f"DROP TRIGGER {trigger}")
    ((_, what),) = findings()
    assert what == "the triggers that protect the audit against changes are missing or disabled"


def test_what_nobody_names_is_found(data: Path, findings: Findings) -> None:
    stream = RecordingFiles(data).stream(SweepAttempt(2, 1, 1))
    stream.write_bytes(b"samples")
    stream.with_name("0002-1.arrows.unknown").touch()
    stream.with_name(".0003-1.partial.parquet").touch()
    (data / "sweepid.sqlite.old").touch()
    (data / "transfer" / "import-1").mkdir(parents=True)
    (data / "transfer" / "import-1" / "bundle.zip").touch()
    of_service = [
        ("transfer/import-1/bundle.zip", "left over from a service process that was killed"),
        ("recordings/campaign-000002/0001-1.arrows", "left over from a service process that was killed"),
    ]
    always = [
        ("sweepid.sqlite.old", "not referenced by the database"),
        ("recordings/campaign-000002/.0003-1.partial.parquet", "not referenced by the database"),
        (
            "recordings/campaign-000002/0002-1.arrows.unknown",
            "a stream that the service set aside, because it contains no complete recording",
        ),
    ]
    assert sorted(findings()) == sorted(of_service + always)
    with open_database(f"sqlite:///{data / 'sweepid.sqlite'}") as database:
        lease = MachineLease(database, 1.0)
        lease.acquire()
        assert sorted(findings()) == sorted(always)  # the others are under way
        lease.release()


def test_a_damaged_database_is_found_and_refused(data: Path, backup: Path, tmp_path: Path, findings: Findings) -> None:
    for place in (data / "sweepid.sqlite", backup / "data" / "sweepid.sqlite"):
        content = bytearray(place.read_bytes())
        content[8192:12288] = bytes(4096)
        place.write_bytes(content)
    assert findings()
    with pytest.raises(BadInput, match=r"SHA-256 is not .*: the backup is not complete"):
        restore(backup, tmp_path / "restored")
    remade(backup)
    with pytest.raises(BadInput, match="is not a complete database"):
        restore(backup, tmp_path / "restored")
    assert not (tmp_path / "restored").exists()


def test_a_lost_or_foreign_database_is_found(data: Path, findings: Findings) -> None:
    owner = (data / OWNER_FILE).read_text("utf-8")
    (data / OWNER_FILE).write_text(owner.replace('"id": "', '"id": "x'), "utf-8")
    ((place, what),) = findings()
    assert (place, "belongs to database x" in what) == (OWNER_FILE, True)
    (data / OWNER_FILE).write_text("{", "utf-8")
    assert findings() == [(OWNER_FILE, "does not name the database of the data folder")]
    (data / OWNER_FILE).unlink()
    (data / OWNER_FILE).mkdir()
    assert findings() == [(OWNER_FILE, f"cannot be read: [Errno 21] Is a directory: '{data / OWNER_FILE}'")]
    (data / "sweepid.sqlite").write_bytes(b"no database at all, but long enough to be read as one" * 100)
    assert findings() == [("sweepid.sqlite", "cannot be read: file is not a database")]
    (data / "sweepid.sqlite").unlink()
    assert findings() == [("sweepid.sqlite", "database is missing")]
    shutil.rmtree(data)
    assert [place for place, _ in findings()] == [str(data), "sweepid.sqlite"]


def test_a_full_disk_is_found(data: Path) -> None:
    told = sweepid("data", "doctor", "--data-dir", str(data))
    assert told.returncode == 0
    settings = data.parent / "settings.yaml"
    settings.write_text(json.dumps({"data_dir": str(data), "least_free_disk": 10**18}), "utf-8")
    told = sweepid("data", "doctor", "--config", str(settings))
    assert (told.returncode, told.stdout.count("\n")) == (1, 1)
    assert "limit 1000000000000000000 bytes; make room" in told.stdout


@pytest.mark.parametrize("schema", ["9999", "0017"])
def test_another_schema_is_refused(data: Path, backup: Path, tmp_path: Path, findings: Findings, schema: str) -> None:
    for place in (data / "sweepid.sqlite", backup / "data" / "sweepid.sqlite"):
        with closing(sqlite3.connect(place)) as database, database:
            database.execute("UPDATE alembic_version SET version_num = ?", (schema,))
    told = f"has schema {schema}, which this sweepid does not know: use the sweepid that wrote it"
    (found,) = findings()
    assert found[1] == f"database: {told}"
    with pytest.raises(BadInput, match=told), open_database(f"sqlite:///{data / 'sweepid.sqlite'}"):
        pass
    with pytest.raises(BadInput, match=told):
        make_backup(data / "sweepid.sqlite", data, tmp_path / "second")
    remade(backup)
    with pytest.raises(BadInput, match=told):
        restore(backup, tmp_path / "restored")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["backup", "data"]


@pytest.mark.parametrize("what", ["no manifest", "cut manifest", "file not in it", "path out of it", "other database"])
def test_a_manifest_that_does_not_fit_is_refused(backup: Path, tmp_path: Path, what: str) -> None:
    place = backup / FILE
    told = json.loads(place.read_text("utf-8"))
    spectrum = next(path for path in told["files"] if "spectrum" in path)
    if what == "no manifest":
        place.unlink()
    elif what == "cut manifest":
        place.write_text(place.read_text("utf-8")[:-20], "utf-8")
    else:
        if what == "file not in it":
            del told["files"][spectrum]
        elif what == "path out of it":
            told["files"]["../" + spectrum] = told["files"].pop(spectrum)
        else:
            told["database"] = "0" * 32
        place.write_text(json.dumps(told), "utf-8")
    with pytest.raises(BadInput, match="backup"):
        restore(backup, tmp_path / "restored")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["backup", "data"]


def remade(backup: Path) -> None:
    """The manifest tells the files as they are."""
    manifest = read_manifest(backup)
    files = {
        path: stored.model_copy(
            update={"size": (backup / "data" / path).stat().st_size, "sha256": file_sha256(backup / "data" / path)}
        )
        for path, stored in manifest.files.items()
    }
    (backup / FILE).write_text(manifest.model_copy(update={"files": files}).model_dump_json(), "utf-8")
