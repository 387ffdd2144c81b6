"""Bundles made to harm: the service neither grows nor breaks, and keeps nothing of them."""

import os
import signal
import sys
import threading
import zipfile
from collections.abc import Iterator
from pathlib import Path

import httpx
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from service.model.recording import Sweep
from service.model.robot import Robot
from service.store.files.bundle import read_bundle, write_bundle
from tests.unit.service.api.conftest import ZIP, packed

pytestmark = [pytest.mark.slow, pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")]
ROOM = 100 * 2**10  # kB that the service may grow by


def children(parent: int | str, name: bytes) -> list[int]:
    """Child processes of another with a word in their command."""
    found: list[int] = []
    for path in Path(f"/proc/{parent}/task").glob("*/children"):
        for child in path.read_text().split():
            try:
                command = Path(f"/proc/{child}/cmdline").read_bytes()
            except FileNotFoundError:
                continue
            if name in command:
                found.append(int(child))
    return found


@pytest.fixture
def service(served: str, served_in: Path) -> int:
    """Its process."""
    (found,) = children("self", str(served_in).encode())
    return found


@pytest.fixture
def http(served: str) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=f"{served}/api/v1", timeout=30, trust_env=False) as client:
        yield client


def most_memory(process: int) -> int:
    """kB, since it began."""
    lines = Path(f"/proc/{process}/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM"))


def stored(http: httpx.Client, folder: Path) -> tuple[int, list[str]]:
    """Campaigns, and the folders of what was recorded or comes in."""
    data = folder / "data"
    names = [path.name for kind in ("recordings", "transfer") for path in data.glob(f"{kind}/*")]
    return len(http.get("/campaigns", params={"limit": 200}).json()["items"]), sorted(names)


def test_a_file_that_unfolds_does_not_make_the_service_grow(
    http: httpx.Client, served_in: Path, service: int, bundle: Path, robot: Robot, tmp_path: Path
) -> None:
    write_bundle(tmp_path / "bundle", robot, read_bundle(bundle).sweeps)
    zeros = pa.array(np.zeros(8_000_000))  # 64 MB a column
    table = pa.table(dict.fromkeys(("time", "effort", "velocity", "position"), zeros))
    pq.write_table(table, tmp_path / "bundle" / "sweeps" / "0001.parquet")
    before, memory = stored(http, served_in), most_memory(service)
    refused = http.post("/bundles", content=packed(tmp_path / "bundle", zipfile.ZIP_DEFLATED), headers=ZIP, timeout=120)
    assert refused.status_code == 422
    assert "time does not increase" in refused.json()["detail"]
    assert most_memory(service) - memory < ROOM
    assert stored(http, served_in) == before


@pytest.mark.parametrize("key", [{}, {"Idempotency-Key": "a large body"}], ids=["alone", "with a key"])
def test_a_large_body_does_not_make_the_service_grow(
    http: httpx.Client, served_in: Path, service: int, key: dict[str, str]
) -> None:
    before, memory = stored(http, served_in), most_memory(service)
    refused = http.post("/bundles", content=(bytes(2**20) for _ in range(200)), headers=ZIP | key, timeout=120)
    assert refused.status_code == 422, refused.text
    assert most_memory(service) - memory < ROOM
    assert stored(http, served_in) == before


def test_a_reader_killed_while_it_stores_leaves_nothing(
    http: httpx.Client, served_in: Path, service: int, bundle: Path, robot: Robot, tmp_path: Path
) -> None:
    (first, *_) = read_bundle(bundle).sweeps
    many = [Sweep(first.spec.model_copy(update={"id": str(n)}), first.recording) for n in range(60)]
    write_bundle(tmp_path / "bundle", robot, many)
    before, content, answers = (
        stored(http, served_in),
        packed(tmp_path / "bundle", zipfile.ZIP_DEFLATED),
        list[httpx.Response](),
    )
    sender = threading.Thread(target=lambda: answers.append(http.post("/bundles", content=content, headers=ZIP)))
    sender.start()
    while not list((served_in / "data" / "transfer").glob("import-*/recordings/import-*/*.json")):
        assert sender.is_alive(), answers[0].text
    (reader,) = children(service, b"service.store.files.isolated_reader")
    os.kill(reader, signal.SIGKILL)
    sender.join()
    assert answers[0].status_code == 422
    assert "SIGKILL" in answers[0].json()["detail"]
    assert "4294967296 bytes of memory and 600 s" in answers[0].json()["detail"]
    assert stored(http, served_in) == before
