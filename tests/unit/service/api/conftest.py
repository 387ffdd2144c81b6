"""The whole service with real SQLite and without a machine: `hosting` in this process, `serving` as it is run."""

import io
import json
import subprocess
import zipfile
from collections.abc import AsyncIterator, Iterator, Mapping
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path

import httpx
import pytest

from service.model import Robot
from service.model.configuration import read_robot
from service.process.settings import Settings
from service.store.files.bundle import write_bundle
from service.web.app import create_app
from service.web.application import Application
from service.web.client import ServiceClient
from tests.command import SWEEPID
from tests.rigid_sweep import rigid_sweep
from tests.unit.service.hosting import CONFIG, hosting, settings_of

ZIP = {"Content-Type": "application/zip"}


@contextmanager
def started(
    settings: Path, environment: Mapping[str, str] | None = None
) -> Iterator[tuple[str, "subprocess.Popen[bytes]"]]:
    """`sweepid serve` as a process: its address, until it is killed at the end. Its log is beside the settings."""
    log = settings.with_suffix(".log")
    command = [SWEEPID, "serve", "--config", str(settings), "--port", "0"]
    with (
        log.open("ab") as stderr,
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=stderr, env=environment) as service,
    ):
        try:
            line = service.stdout.readline() if service.stdout else b""
            if not line:
                raise RuntimeError(f"the service did not start: {log.read_text('utf-8')}")
            yield json.loads(line)["url"], service
        finally:
            service.kill()


@contextmanager
def serving(folder: Path, profile: Path, **settings_too: object) -> Iterator[str]:
    """The same with its data in `folder`; yields its address. It must end cleanly when told to."""
    settings = folder / "service.yaml"
    settings.write_text(json.dumps(settings_of(folder, profile, **settings_too)), encoding="utf-8")
    with started(settings) as (url, service):
        yield url
        service.terminate()
        assert service.wait(30) == 0, settings.with_suffix(".log").read_text("utf-8")


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
    """The data and the log of the service at `url`."""
    return tmp_path_factory.mktemp("service")


@pytest.fixture(scope="session")
def url(folder: Path, profile: Path) -> Iterator[str]:
    with hosting(folder, profile) as url:
        yield url


@pytest.fixture
def http(url: str) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=f"{url}/api/v1", timeout=30, trust_env=False) as client:
        yield client


@pytest.fixture(scope="session")
def served_in(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The data, the settings and the log of the service at `served`."""
    return tmp_path_factory.mktemp("served")


@pytest.fixture(scope="session")
def served(served_in: Path, profile: Path) -> Iterator[str]:
    """A process that listens at a port: for what a call in this process does not show."""
    with serving(served_in, profile) as url:
        yield url


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


def packed(folder: Path, kind: int = zipfile.ZIP_STORED) -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", kind) as archive:
        for path in sorted(folder.rglob("*")):
            archive.write(path, path.relative_to(folder))
    return content.getvalue()


def identified(url: str, bundle: Path) -> int:
    """A campaign of the bundle; its sweeps are identified and its data checked."""
    added = httpx.post(f"{url}/api/v1/bundles", content=packed(bundle), headers=ZIP, timeout=60, trust_env=False)
    number = int(added.raise_for_status().json()["id"])
    assert added.headers["location"].endswith(f"/campaigns/{number}")
    with ServiceClient(url) as client:
        wanted = {"completed", "checked"}
        for event in client.events(number):
            wanted -= {event["data"].get("state"), "checked" if event["kind"] == "data_check" else ""}
            if not wanted:
                break
    return number


@pytest.fixture(scope="module")
def campaign(url: str, bundle: Path) -> int:
    """Its number; at the beginning of a module its estimate is the latest of all."""
    return identified(url, bundle)


@asynccontextmanager
async def opened(data: Path, profile: Path, **given: object) -> AsyncIterator[tuple[Application, httpx.AsyncClient]]:
    """A service in the test's own loop, with its worker process."""
    app = create_app(Settings.model_validate(settings_of(data, profile) | {"data_dir": data} | given))
    async with app.router.lifespan_context(app):
        way = httpx.ASGITransport(app=app)
        async with httpx.AsyncClient(transport=way, base_url="http://127.0.0.1/api/v1", timeout=60) as http:
            yield app.state.application, http
