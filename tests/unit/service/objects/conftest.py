"""Both kinds of a store, real ones: a folder, and an S3 server of another maker."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from service.process.settings import StoreAddress, store_address
from tests.object_store_server import BUCKET, S3Server, Wire, key_file, running_s3, wire_to
from tests.unit.service.backup.conftest import data, measured, recording

__all__ = ["data", "measured", "recording"]

WAIT = 1.0  # s that a store may say nothing


@pytest.fixture(scope="session")
def s3_server() -> Iterator[S3Server]:
    with running_s3() as server:
        yield server


@pytest.fixture
def s3(s3_server: S3Server) -> S3Server:
    """With an empty bucket."""
    s3_server.reset()
    return s3_server


@pytest.fixture
def wire(s3: S3Server) -> Iterator[Wire]:
    with wire_to(s3) as wire:
        yield wire


@pytest.fixture
def through_wire(wire: Wire, tmp_path: Path) -> StoreAddress:
    return store_address(f"s3://{BUCKET}/lab", wire.endpoint, key_file(tmp_path), WAIT)


@pytest.fixture(params=["file", "s3"])
def address(request: pytest.FixtureRequest, tmp_path: Path) -> StoreAddress:
    if request.param == "s3":
        server: S3Server = request.getfixturevalue("s3")
        return store_address(f"s3://{BUCKET}/lab", server.endpoint, key_file(tmp_path), WAIT)
    folder = tmp_path / "share"
    folder.mkdir()
    return store_address(folder.as_uri(), None, None, WAIT)
