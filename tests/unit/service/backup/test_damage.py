"""What is damaged is found by `doctor`, and refused by `restore` in a backup."""

import json
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from service.model.errors import BadInput
from service.store.backup import FILE, make_backup, read_manifest, restore
from service.store.database import open_database
from service.store.files.data_folder import FILE as OWNER
from service.store.files.recordings import RecordingFiles, Run, file_sha256
from service.store.guards import MachineLease
from tests.command import sweepid
from tests.unit.service.backup.conftest import contents

pytestmark = pytest.mark.slow

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
    with pytest.raises(BadInput, match=place.name):
        restore(backup, tmp_path / "restored")
    assert contents(tmp_path) == before
    told = sweepid("data", "doctor", "--data-dir", str(data))
    assert (told.returncode, told.stdout.count("\n"), told.stderr) == (1, 1, "")
    assert f"copy data/{place.as_posix()} of a backup there" in told.stdout


def test_a_whole_folder_has_no_findings_and_is_not_touched(data: Path, findings: Findings) -> None:
    before = contents(data)
    assert findings() == []
    told = sweepid("data", "doctor", "--data-dir", str(data))
    assert (told.returncode, told.stdout, told.stderr) == (0, "", "")
    assert contents(data) == before


@pytest.mark.parametrize("trigger", ["audit_no_update", "audit_no_delete", "audit_no_replace"])
def test_an_audit_without_its_protection_is_found(data: Path, findings: Findings, trigger: str) -> None:
    with closing(sqlite3.connect(data / "sweepid.sqlite")) as database:
        database.execute(f"DROP TRIGGER {trigger}")
    ((_, what),) = findings()
    assert what == "the triggers that protect the audit against changes are missing or disabled"


def test_what_nobody_names_is_found(data: Path, findings: Findings) -> None:
    stream = RecordingFiles(data).stream(Run(2, 1, 1))
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
    owner = (data / OWNER).read_text("utf-8")
    (data / OWNER).write_text(owner.replace('"id": "', '"id": "x'), "utf-8")
    ((place, what),) = findings()
    assert (place, "belongs to database x" in what) == (OWNER, True)
    (data / OWNER).write_text("{", "utf-8")
    assert findings() == [(OWNER, "does not name the database of the data folder")]
    (data / OWNER).unlink()
    (data / OWNER).mkdir()
    assert findings() == [(OWNER, f"cannot be read: [Errno 21] Is a directory: '{data / OWNER}'")]
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
