"""A data folder belongs to one database."""

from pathlib import Path

import numpy as np
import pytest

from service import BadInput
from service.model import Recording, Robot, SweepSpec
from service.store.database import open_database
from service.store.documents import NewRecording, NewSweep, RecordingState
from service.store.files.data_folder import OWNER_FILE, ForeignFolder, claim_folder
from service.store.files.recordings import RecordingFiles, SweepAttempt
from service.store.store import Store
from tests.unit.service.store.conftest import Specs

TIME = np.arange(100) / 100.0


@pytest.fixture
def url(sqlite_url: str) -> str:
    return sqlite_url


def recorded(folder: Path, kind: str = "campaign-000001") -> Path:
    path = folder / "recordings" / kind / "0001-1.parquet"
    path.parent.mkdir(parents=True)
    RecordingFiles(folder).save(path, Recording(TIME, TIME, TIME, TIME), RecordingState.COMPLETE, {})
    return path


def add_campaign(store: Store, robot: Robot, spec: SweepSpec) -> None:
    recording = NewRecording(state=RecordingState.COMPLETE, path="x", sha256="0" * 64, samples=10)
    store.add_measured(store.add_robot(robot).id, [NewSweep(spec=spec, mode=None)], [recording])


def test_a_folder_stays_with_its_database(tmp_path: Path, url: str, robot: Robot, specs: Specs) -> None:
    for _ in range(2):
        with open_database(url) as database:
            assert claim_folder(tmp_path, database) == ""
    with open_database(f"sqlite:///{tmp_path / 'other.sqlite'}") as other:
        with pytest.raises(ForeignFolder, match=r"(?s)(?=.*sweepid\.sqlite).*other\.sqlite"):
            claim_folder(tmp_path, other)
        recorded(tmp_path)
        add_campaign(Store(other), robot, specs[0])
        with pytest.raises(ForeignFolder):
            claim_folder(tmp_path, other)


@pytest.mark.parametrize("kind", ["campaign-000001", "import-0"])
@pytest.mark.parametrize("claimed", [True, False])
def test_a_lost_database_is_told(tmp_path: Path, url: str, kind: str, claimed: bool) -> None:
    """With its folder's file, or with a folder from before there was one."""
    if claimed:
        with open_database(url) as database:
            claim_folder(tmp_path, database)
        for part in tmp_path.glob("sweepid.sqlite*"):
            part.unlink()
    recorded(tmp_path, kind)
    with open_database(url) as database:
        assert "contains 1 recordings" in claim_folder(tmp_path, database)
        assert "restore it from a backup" in claim_folder(tmp_path, database)
    assert (tmp_path / OWNER_FILE).exists() is claimed


def test_what_a_killed_import_left_makes_no_lost_database_and_a_damaged_file_is_told(tmp_path: Path, url: str) -> None:
    with open_database(url) as database:
        claim_folder(tmp_path, database)
        recorded(tmp_path, "import-0")
        assert claim_folder(tmp_path, database) == ""
        (tmp_path / OWNER_FILE).write_text("{", "utf-8")
        with pytest.raises(BadInput, match="does not name the database"):
            claim_folder(tmp_path, database)


def test_a_folder_from_before_is_taken_with_its_own_database(
    tmp_path: Path, url: str, robot: Robot, specs: Specs
) -> None:
    recorded(tmp_path)
    with open_database(url) as database:
        add_campaign(Store(database), robot, specs[0])
        assert claim_folder(tmp_path, database) == ""
    assert (tmp_path / OWNER_FILE).exists()


def test_a_recording_is_never_overwritten(tmp_path: Path) -> None:
    first = recorded(tmp_path)
    content, manifest = first.read_bytes(), first.with_suffix(".json").read_bytes()
    files = RecordingFiles(tmp_path)
    names = [
        files.save(first, Recording(TIME, 2 * TIME, TIME, TIME), RecordingState.PARTIAL, {}).path for _ in range(2)
    ]
    assert [Path(name).name for name in names] == ["0001-1.2.parquet", "0001-1.3.parquet"]
    assert (first.read_bytes(), first.with_suffix(".json").read_bytes()) == (content, manifest)
    assert sorted(path.name for path in first.parent.iterdir() if path.name.startswith(".")) == []
    assert files.last_attempt(1, 1) == 1
    assert files.last_attempt(1, 2) == 0


def test_what_is_put_aside_takes_no_other_place(tmp_path: Path) -> None:
    files = RecordingFiles(tmp_path)
    for number in (1, 2):
        stream = files.stream(SweepAttempt(1, 1, 4))
        stream.write_bytes(b"%d" % number)
        files.put_aside(stream, "unknown")
    assert files.streams() == {}
    assert [path.read_bytes() for path in sorted(stream.parent.iterdir())] == [b"1", b"2"]
    assert files.last_attempt(1, 1) == 4
