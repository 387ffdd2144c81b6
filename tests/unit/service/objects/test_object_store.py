"""Objects come and go whole, by their hash; a worker reads a recording wherever it lies."""

import dataclasses
import os
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from service import BadInput
from service.process.settings import Settings, StoreAddress, store_address
from service.store.files.columns import read_columns
from service.store.files.recordings import RecordingFile, file_sha256
from service.store.objects import MissingObject, ObjectStore, StoreAway, WrongObject, check_usable, read_recording
from service.store.retention import make_room
from tests.object_store_server import BUCKET, S3Server, key_file
from tests.unit.service.objects.conftest import WAIT


def edit(address: StoreAddress, request: pytest.FixtureRequest, sha256: str, content: bytes) -> None:
    """Another hand in the store."""
    if address.protocol == "file":
        Path(address.key(sha256)).write_bytes(content)
    else:
        request.getfixturevalue("s3").write(address.key(sha256).removeprefix(f"{BUCKET}/"), content)


def test_what_is_put_is_fetched(address: StoreAddress, recording: Path, tmp_path: Path) -> None:
    sha256 = file_sha256(recording)
    ObjectStore(address).put(recording, sha256)
    ObjectStore(address).check(sha256, recording.stat().st_size)
    ObjectStore(address).fetch(sha256, tmp_path / "fetched")
    assert (tmp_path / "fetched").read_bytes() == recording.read_bytes()
    recording.unlink()
    ObjectStore(address).put(recording, sha256)  # it is there, as a database from a backup does not know


def test_one_that_is_there_is_not_written_again(tmp_path: Path, recording: Path) -> None:
    address = store_address(tmp_path.as_uri(), None, None, WAIT)
    sha256 = file_sha256(recording)
    ObjectStore(address).put(recording, sha256)
    before = Path(address.key(sha256)).stat()
    ObjectStore(address).put(recording, sha256)
    assert Path(address.key(sha256)).stat().st_ino == before.st_ino


def test_two_services_put_the_same(address: StoreAddress, recording: Path, request: pytest.FixtureRequest) -> None:
    sha256 = file_sha256(recording)
    start = threading.Barrier(2)

    def put(_: int) -> None:
        start.wait()
        for _ in range(5):  # as a service does: this server refuses at times what it is being sent twice
            with suppress(StoreAway):
                return ObjectStore(address).put(recording, sha256)
        raise AssertionError("refused each time")

    with ThreadPoolExecutor(2) as both:
        assert list(both.map(put, range(2))) == [None, None]
    ObjectStore(address).check(sha256)
    if address.protocol == "s3":
        assert len(request.getfixturevalue("s3").keys()) == 1
    else:
        assert len([path for path in Path(address.root).rglob("*") if path.is_file()]) == 1


@pytest.mark.slow
@pytest.mark.parametrize("wrong", [b"", b"something else", None])
def test_a_wrong_object_is_told_and_repaired(
    address: StoreAddress, recording: Path, tmp_path: Path, request: pytest.FixtureRequest, wrong: bytes | None
) -> None:
    sha256 = file_sha256(recording)
    store = ObjectStore(address)
    store.put(recording, sha256)
    content = recording.read_bytes()
    edit(address, request, sha256, content[:-1] + bytes([content[-1] ^ 1]) if wrong is None else wrong)
    told = f"{address.shown(sha256)}: object was changed, SHA-256 is not {sha256}"
    with pytest.raises(WrongObject, match=told):
        store.check(sha256)
    with pytest.raises(WrongObject, match=told):
        store.fetch(sha256, tmp_path / "fetched")
    assert not (tmp_path / "fetched").exists()
    store.put(recording, sha256)
    store.check(sha256)


def test_a_file_that_was_changed_is_not_put(address: StoreAddress, recording: Path) -> None:
    sha256 = file_sha256(recording)
    recording.write_bytes(b"changed")
    with pytest.raises(BadInput, match=f"recording file was changed, SHA-256 is not {sha256}"):
        ObjectStore(address).put(recording, sha256)
    with pytest.raises(MissingObject):
        ObjectStore(address).check(sha256)


def test_a_share_that_is_not_mounted_is_not_made(tmp_path: Path, recording: Path) -> None:
    folder = tmp_path / "share"
    store = ObjectStore(store_address(folder.as_uri(), None, None, WAIT))
    with pytest.raises(StoreAway, match="does not exist: create the folder, or mount its share"):
        store.put(recording, file_sha256(recording))
    assert not folder.exists()


def test_no_bucket_and_no_key_are_no_missing_object(s3: S3Server, tmp_path: Path, recording: Path) -> None:
    address = store_address("s3://another/lab", s3.endpoint, key_file(tmp_path), WAIT)
    with pytest.raises(StoreAway, match="bucket does not exist"):
        ObjectStore(address).put(recording, file_sha256(recording))


@pytest.mark.parametrize(
    ("given", "place", "reason"),
    [
        ({"recordings_url": "ftp://x/y"}, "recordings_url", "neither s3://BUCKET/PREFIX nor file:///FOLDER"),
        ({"recordings_url": "s3:///x"}, "recordings_url", "neither"),
        ({"recordings_url": "file://host/x"}, "recordings_url", "neither"),
        ({"recordings_url": "s3://id:secret@bucket/x"}, "recordings_url", "a key belongs in"),
        ({"recordings_url": "s3://bucket/../x"}, "recordings_url", "has .. in it"),
        ({"recordings_url": "file:///x", "recordings_key_file": "/k"}, "recordings_url", "neither endpoint nor key"),
        ({"recordings_key_file": "/k"}, "recordings_url", "is missing"),
    ],
)
def test_what_cannot_be_a_store_is_told(given: dict[str, str], place: str, reason: str) -> None:
    with pytest.raises(BadInput, match=reason) as told:
        Settings.model_validate(given).check()
    assert told.value.place == place
    assert "secret" not in str(told.value)


@pytest.mark.parametrize("content", [None, b"[default]\naws_access_key_id = not-for-logs-1\n", b"not-for-logs-2 \xff"])
def test_a_key_file_that_is_none_is_told_without_its_content(tmp_path: Path, content: bytes | None) -> None:
    if content is not None:
        (tmp_path / "key").write_bytes(content)
    with pytest.raises(BadInput) as told:
        check_usable(store_address("s3://bucket", None, tmp_path / "key", WAIT))
    assert told.value.place == "recordings_key_file"
    assert "not-for-logs" not in str(told.value)


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


def test_one_that_was_changed_here_or_is_nowhere_is_told(moved: RecordingFile) -> None:
    lost = dataclasses.replace(moved, sha256="0" * 64)
    with pytest.raises(BadInput, match=r"recording file is missing, and .*: object is missing"):
        read_recording(lost)
    with pytest.raises(StoreAway, match="yet"):  # it is on its way: the job waits
        read_recording(dataclasses.replace(lost, was_here=True))
    moved.path.write_bytes(b"changed")
    with pytest.raises(BadInput, match=f"recording file was changed, SHA-256 is not {moved.sha256}"):
        read_recording(moved)


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
