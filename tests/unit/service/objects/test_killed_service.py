"""`sweepid serve` is killed in the middle of an upload: the next one brings the recording there once, as it was."""

import json
import time
from pathlib import Path

import httpx
import pytest

from tests.object_store_server import BUCKET, S3Server, Wire, key_file, without_keys
from tests.unit.service.api.conftest import profile, started
from tests.unit.service.hosting import settings_of

__all__ = ["profile"]

pytestmark = pytest.mark.slow

PATIENCE = 60.0  # s


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
