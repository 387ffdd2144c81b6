"""Recordings move by themselves, wait for a store that is gone, and come back to whoever wants them."""

import asyncio
import json
import os
import time
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

import httpx
import pytest

from service import BadInput, NotNow
from service.jobs.recording_uploads import RecordingUploads, Transfers
from service.process.settings import Settings, StoreAddress
from service.process.tasks import Background
from service.store.back_up import make_backup, restore
from service.store.database import open_database
from service.store.documents import RecordingDocument
from service.store.examination import examine
from service.store.files.recordings import RecordingFiles
from service.store.retention import MoveStore
from service.store.store import Store
from tests.object_store_server import BUCKET, S3Server, Wire, key_file, without_keys
from tests.unit.service.api.conftest import profile, started
from tests.unit.service.campaigns.conftest import until
from tests.unit.service.hosting import settings_of

pytestmark = pytest.mark.slow

PATIENCE = 60.0  # s


@dataclass(frozen=True)
class Bench:
    files: RecordingFiles
    moving: RecordingUploads
    documents: tuple[RecordingDocument, ...]

    async def until(self, holds: Callable[[int, str], bool]) -> None:
        """Of the number that waits, and the trouble."""

        def so() -> bool:
            found = self.moving.backlog()
            return holds(found.waiting, found.trouble)

        await until(so)


@asynccontextmanager
async def moving(data: Path, address: StoreAddress, cache: int = 0) -> AsyncGenerator[Bench]:
    """What a service does beside everything else; files are old enough to go."""
    for path in recordings(data):
        os.utime(path, (0, 0))
    settings = Settings(data_dir=data, recordings_cache=cache, recordings_retry=0.1)
    with open_database(settings.url) as database:
        transfers, tasks = Transfers(), Background()
        files = RecordingFiles(data, address, transfers.fetch)
        bench = Bench(
            files,
            RecordingUploads(MoveStore(database), files, settings, transfers),
            tuple(Store(database).recordings(1).values()),
        )
        tasks.begin("move recordings", bench.moving.follow())
        try:
            yield bench
        finally:
            await tasks.close()
            await transfers.close()


def recordings(data: Path) -> list[Path]:
    return sorted(data.glob("recordings/*/*.parquet"))


async def test_they_move_make_room_and_come_back(data: Path, through_wire: StoreAddress, s3: S3Server) -> None:
    before = {path: path.read_bytes() for path in recordings(data)}
    async with moving(data, through_wire) as bench:
        await bench.until(lambda waiting, _: waiting == 0)
        await until(lambda: not recordings(data))
        assert sorted(map(s3.read, s3.keys())) == sorted(before.values())
        assert s3.keys() == sorted(f"lab/{one.sha256[:2]}/{one.sha256}.parquet" for one in bench.documents)
        paths = [await asyncio.to_thread(bench.files.local, one) for one in bench.documents]
        assert {path: path.read_bytes() for path in paths} == before
        assert all(path.with_suffix(".json").exists() for path in paths)


async def test_a_store_that_is_gone_is_waited_for(
    data: Path, through_wire: StoreAddress, wire: Wire, s3: S3Server
) -> None:
    wire.cut()
    async with moving(data, through_wire) as bench:
        await bench.until(lambda waiting, trouble: waiting == 2 and "Could not connect" in trouble)
        assert (await asyncio.to_thread(bench.moving.backlog)).since is not None
        assert len(recordings(data)) == 2
        wire.mend()
        await bench.until(lambda waiting, trouble: (waiting, trouble) == (0, ""))
        assert len(s3.keys()) == 2
        wire.cut()
        for path in recordings(data):
            path.unlink()
        with pytest.raises(NotNow, match="Could not connect"):
            await asyncio.to_thread(bench.files.local, bench.documents[0])


async def test_one_that_was_changed_stays_and_the_other_moves(
    data: Path, through_wire: StoreAddress, s3: S3Server
) -> None:
    changed = recordings(data)[0]
    changed.write_bytes(b"changed")
    async with moving(data, through_wire, cache=2**40) as bench:
        await bench.until(lambda waiting, trouble: waiting == 1 and "was changed" in trouble)
        assert len(s3.keys()) == 1
        assert len(recordings(data)) == 2  # there is room


async def test_a_wrong_or_missing_object_is_told_to_who_wants_it(
    data: Path, through_wire: StoreAddress, s3: S3Server
) -> None:
    async with moving(data, through_wire, cache=2**40) as bench:
        await bench.until(lambda waiting, _: waiting == 0)
        for path in recordings(data):
            path.unlink()
        wrong, missing = (f"lab/{one.sha256[:2]}/{one.sha256}.parquet" for one in bench.documents)
        s3.write(wrong, b"wrong")
        s3.remove(missing)
        with pytest.raises(BadInput, match=f"object was changed, SHA-256 is not {bench.documents[0].sha256}"):
            await asyncio.to_thread(bench.files.local, bench.documents[0])
        with pytest.raises(BadInput, match=r"recording file is missing, and .*: object is missing"):
            await asyncio.to_thread(bench.files.local, bench.documents[1])
        assert recordings(data) == []
    found = [(each.place, each.what) for each in examine(data / "sweepid.sqlite", data, 0, through_wire)]
    assert (f"s3://{BUCKET}/{wrong}", f"object was changed, SHA-256 is not {bench.documents[0].sha256}") in found
    assert (f"s3://{BUCKET}/{missing}", "object is missing") in found
    assert len(found) == 2


async def test_backup_restore_and_doctor_know_them(
    data: Path, through_wire: StoreAddress, wire: Wire, tmp_path: Path
) -> None:
    database = data / "sweepid.sqlite"
    async with moving(data, through_wire, cache=2**40) as bench:
        await bench.until(lambda waiting, _: waiting == 0)
    gone = recordings(data)[0]
    gone.unlink()
    assert examine(database, data, 0, through_wire) == ()
    (unset,) = examine(database, data, 0)
    assert unset.what == "2 recordings are in an object store, but none is configured"
    manifest = make_backup(database, data, tmp_path / "backup")
    relative = gone.relative_to(data).as_posix()
    assert list(manifest.in_store) == [relative]
    assert relative not in manifest.files
    assert sum(path.endswith(".parquet") for path in manifest.files) == 1
    again = tmp_path / "again"
    assert restore(tmp_path / "backup", again) == manifest
    assert examine(again / "sweepid.sqlite", again, 0, through_wire) == ()
    wire.cut()
    (away,) = examine(database, data, 0, through_wire)
    assert "Could not connect" in away.place


__all__ = ["profile"]


def metric(http: httpx.Client, name: str) -> float:
    text = http.get("/metrics").text
    return next(float(line.split()[1]) for line in text.splitlines() if line.startswith(f"{name} "))


def test_what_was_on_its_way_arrives_once(data: Path, s3: S3Server, wire: Wire, tmp_path: Path, profile: Path) -> None:
    paths = sorted(data.glob("recordings/*/*.parquet"))
    before = [path.read_bytes() for path in paths]
    settings = tmp_path / "service.yaml"
    store = {"recordings_url": f"s3://{BUCKET}/lab", "recordings_endpoint": wire.endpoint, "recordings_retry": 0.2}
    store |= {"recordings_key_file": str(key_file(tmp_path)), "data_dir": str(data)}
    settings.write_text(json.dumps(settings_of(tmp_path, profile, **store)), "utf-8")
    wire.hold_after(100_000)  # in the middle of a recording
    with started(settings, without_keys()) as (url, service), httpx.Client(base_url=url, timeout=PATIENCE) as http:
        assert wire.held.wait(PATIENCE)
        told = http.get("/api/v1/health/ready").json()["recordings"]
        assert told["waiting"] == metric(http, "sweepid_recordings_waiting") == 2
        assert told["since"] is not None
        service.kill()
        service.wait()
    assert s3.keys() == []
    assert [path.read_bytes() for path in paths] == before
    wire.hold_after(None)
    with started(settings, without_keys()) as (url, service), httpx.Client(base_url=url, timeout=PATIENCE) as http:
        deadline = time.monotonic() + PATIENCE
        while metric(http, "sweepid_recordings_waiting"):
            assert time.monotonic() < deadline
            time.sleep(0.05)
        for path in paths:
            path.unlink()  # as if the cache had no room for them
        found = [http.get(f"/api/v1/campaigns/1/sweeps/{number}/recording/file") for number in (1, 2)]
        assert [each.content for each in found] == before
        hashes = [each.headers["X-Content-SHA256"] for each in found]
        service.terminate()
        assert service.wait(PATIENCE) == 0
    assert s3.keys() == sorted(f"lab/{sha256[:2]}/{sha256}.parquet" for sha256 in hashes)
    assert [s3.read(f"lab/{sha256[:2]}/{sha256}.parquet") for sha256 in hashes] == before
    assert "not-for-logs" not in settings.with_suffix(".log").read_text("utf-8")
