"""A worker reads a recording wherever it lies, and only what was recorded."""

import dataclasses
import os
from pathlib import Path

import numpy as np
import pytest

from service.errors import BadInput
from service.settings.object_store import StoreAddress
from service.store.files.columns import read_columns
from service.store.files.recordings import RecordingFile, file_sha256
from service.store.objects.cache import make_room
from service.store.objects.object_store import ObjectStore, StoreAway
from service.store.objects.reading import read_recording


@pytest.fixture
def moved(address: StoreAddress, data: Path, recording: Path) -> RecordingFile:
    """In the store alone."""
    (data / "transfer").mkdir()
    file = RecordingFile(recording, file_sha256(recording), data / "transfer", address, was_here=False)
    ObjectStore(address).put(recording, file.sha256)
    recording.rename(recording.with_suffix(".kept"))
    return file


def test_it_comes_into_the_data_folder(moved: RecordingFile) -> None:
    read = read_recording(moved)
    assert moved.path.read_bytes() == moved.path.with_suffix(".kept").read_bytes()
    assert np.array_equal(read.effort, read_columns(moved.path).effort)
    assert list(moved.transfer.iterdir()) == []


def test_elsewhere_nothing_is_left(moved: RecordingFile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    elsewhere = dataclasses.replace(
        moved, path=tmp_path / "no" / moved.path.name, transfer=tmp_path / "no" / "transfer"
    )
    assert read_recording(elsewhere).time.size == 10_000
    assert list((tmp_path / "temporary").iterdir()) == []
    assert not (tmp_path / "no").exists()


def test_one_that_was_changed_here_is_told(moved: RecordingFile) -> None:
    moved.path.write_bytes(b"changed")
    with pytest.raises(BadInput, match=f"recording file was changed, SHA-256 is not {moved.sha256}"):
        read_recording(moved)


def test_one_that_is_nowhere_is_told(moved: RecordingFile) -> None:
    lost = dataclasses.replace(moved, sha256="0" * 64)
    with pytest.raises(BadInput, match=r"recording file is missing, and .*: object is missing"):
        read_recording(lost)
    with pytest.raises(StoreAway, match="yet"):  # it is on its way: the job waits
        read_recording(dataclasses.replace(lost, was_here=True))


def test_the_newest_stay_and_what_is_in_use(data: Path) -> None:
    paths = sorted(data.glob("recordings/*/*.parquet"))
    names = [path.relative_to(data).as_posix() for path in paths]
    size = paths[0].stat().st_size
    for path in paths:
        os.utime(path)
    assert make_room(data, 0, lambda: names) == 0  # just written
    for age, path in zip((2000, 1000), paths, strict=True):
        at = path.stat().st_mtime - age
        os.utime(path, (at, at))
    assert make_room(data, 0, list) == 0  # not in the store
    assert make_room(data, 3 * size, lambda: names) == 0
    assert make_room(data, size + size // 2, lambda: names) == 1
    assert [path.exists() for path in paths] == [False, True]
    assert make_room(data, 0, lambda: names) == 1
