"""The whole service on a loopback port, with real SQLite and a worker process, and no machine that answers."""

import io
import json
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest

from service.client import ServiceClient
from service.configuration import read_robot
from service.robot import Robot
from service.store.files.bundle import write_bundle
from tests.rigid_sweep import rigid_sweep

CONFIG = Path(__file__).parents[4] / "config"
CAMPAIGNS = 3


@contextmanager
def serving(folder: Path, profile: Path, **settings_too: object) -> Iterator[str]:
    """`sweepid serve` as a process with its data in `folder`; yields its address. It must end cleanly when told to."""
    settings = folder / "service.yaml"
    settings.write_text(
        json.dumps(
            {
                "data_dir": str(folder / "data"),
                "drive": str(profile),
                "robots_dir": str(CONFIG / "robots"),
                "cells_dir": str(CONFIG / "cells"),
                **settings_too,
            }
        ),
        encoding="utf-8",
    )
    command = [str(Path(sys.executable).with_name("sweepid")), "serve", "--config", str(settings), "--port", "0"]
    log = folder / "service.log"
    with log.open("wb") as stderr, subprocess.Popen(command, stdout=subprocess.PIPE, stderr=stderr) as service:
        try:
            line = service.stdout.readline() if service.stdout else b""
            if not line:
                raise RuntimeError(f"the service did not start: {log.read_text('utf-8')}")
            yield json.loads(line)["url"]
            service.terminate()
            assert service.wait(30) == 0, log.read_text("utf-8")
        finally:
            service.kill()


@pytest.fixture(scope="session")
def robot() -> Robot:
    return read_robot(CONFIG / "robots" / "max100-class.yaml")


@pytest.fixture(scope="session")
def profile(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The virtual machine's profile with a port at which nobody listens."""
    text = (CONFIG / "drives" / "virtual-max100.yaml").read_text(encoding="utf-8")
    path = tmp_path_factory.mktemp("profile") / "nobody.yaml"
    eds = CONFIG / "eds" / "virtual-axis.eds"
    path.write_text(text.replace("port: 29536", "port: 1").replace("../eds/virtual-axis.eds", str(eds)), "utf-8")
    return path


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The service's settings and data."""
    return tmp_path_factory.mktemp("service")


@pytest.fixture(scope="session")
def url(folder: Path, profile: Path) -> Iterator[str]:
    with serving(folder, profile) as url:
        yield url


@pytest.fixture
def http(url: str) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=f"{url}/api/v1", timeout=30, trust_env=False) as client:
        yield client


@pytest.fixture(scope="session")
def bundle(tmp_path_factory: pytest.TempPathFactory, robot: Robot) -> Path:
    """Three sweeps of axis 1 in three poses: a rigid body of 300 kg m^2 with viscous friction."""
    folder = tmp_path_factory.mktemp("bundle") / "three-sweeps"
    write_bundle(
        folder,
        robot,
        [rigid_sweep(number, elbow, 300.0 + 50.0 * elbow) for number, elbow in ((1, -0.5), (2, 0.0), (3, 0.5))],
    )
    return folder


def packed(folder: Path) -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        for path in sorted(folder.rglob("*")):
            archive.write(path, path.relative_to(folder))
    return content.getvalue()


@pytest.fixture(scope="module")
def campaigns(url: str, bundle: Path, tmp_path_factory: pytest.TempPathFactory) -> list[int]:
    """The same three sweeps, imported and identified `CAMPAIGNS` times: a robot that does not change at all."""
    archive = tmp_path_factory.mktemp("campaigns") / "bundle.zip"
    archive.write_bytes(packed(bundle))
    with ServiceClient(url) as client:
        numbers = [int(client.import_bundle(archive)["id"]) for _ in range(CAMPAIGNS)]
        for number in numbers:
            for event in client.events(number):
                if event["kind"] == "campaign" and event["data"]["state"] == "completed":
                    break
    return numbers
