"""What a backup holds, and that what is restored of it is the same."""

import json
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from service.model.errors import BadInput
from service.process.settings import load_settings
from service.store.backup import make_backup, read_manifest, restore, sqlite_file
from service.store.database import open_database
from service.store.examination import examine
from service.store.files.data_folder import FILE as OWNER
from service.store.files.data_folder import claim_folder
from service.store.files.recordings import RecordingFiles, Run
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
    RecordingFiles(data).stream(Run(2, 1, 1)).write_bytes(b"samples")
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
    with pytest.raises(BadInput, match="exists already"):
        backup_of(data, tmp_path / "backup")
    with pytest.raises(BadInput, match="is not an empty folder"):
        restore(tmp_path / "backup", data)
    with pytest.raises(BadInput, match="is not an empty folder"):
        restore(tmp_path / "backup", data / "sweepid.sqlite")
    with pytest.raises(BadInput, match="is inside the data folder"):
        backup_of(data, data / "backup")
    with pytest.raises(BadInput, match="No such file"):
        backup_of(data, tmp_path / "not mounted" / "backup")
    assert contents(tmp_path) == before


@pytest.mark.parametrize("what", ["gone", "changed", "foreign", "outside"])
def test_a_damaged_folder_gives_no_backup(data: Path, recording: Path, tmp_path: Path, what: str) -> None:
    if what == "gone":
        recording.unlink()
    elif what == "changed":
        recording.write_bytes(recording.read_bytes()[:-1])
    elif what == "foreign":
        (data / OWNER).write_text('{"id": "other", "database": "x", "machine": 1}', "utf-8")
    else:
        with closing(sqlite3.connect(data / "sweepid.sqlite")) as database, database:
            database.execute("UPDATE recording SET path = '../../outside.parquet' WHERE id = 1")
    with pytest.raises(BadInput) as told:
        backup_of(data, tmp_path / "backup")
    place = {"foreign": OWNER, "outside": "../../outside.parquet"}.get(what, recording.name)
    assert place in str(told.value)
    assert [path.name for path in tmp_path.iterdir()] == ["data"]
