"""The whole service on a loopback port, with real SQLite and a worker process, and no machine that answers."""

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import numpy as np
import pytest

from service.configuration import read_robot
from service.recording import Recording, Sine, Sweep, SweepSpec
from service.robot import Robot
from service.store.files.bundle import write_bundle

CONFIG = Path(__file__).parents[4] / "config"


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
    write_bundle(folder, robot, [_sweep(number, elbow) for number, elbow in ((1, -0.5), (2, 0.0), (3, 0.5))])
    return folder


def _sweep(number: int, elbow: float) -> Sweep:
    rate, periods, offset, inertia, friction = 250.0, 5, 0.0105, 300.0 + 50.0 * elbow, 180.0
    sines = tuple(Sine(frequency=f, amplitude=0.002, phase=f**2) for f in (2.0, 3.0, 4.0, 5.0))
    time = np.arange(int(rate * periods)) / rate
    noise = np.random.default_rng(number).normal(size=len(time))
    angles = [2 * np.pi * sine.frequency * time + sine.phase for sine in sines]
    velocity = offset + sum(sine.amplitude * np.sin(angle) for sine, angle in zip(sines, angles, strict=True))
    acceleration = sum(
        2 * np.pi * sine.frequency * sine.amplitude * np.cos(angle) for sine, angle in zip(sines, angles, strict=True)
    )
    effort = inertia * acceleration + friction * velocity + noise
    position = np.cumsum(velocity) / rate
    spec = SweepSpec(
        id=f"{number:04d}",
        axis="joint_1",
        pose=(0.0, elbow, 0.0, 0.0, 0.0, 0.0),
        offset_velocity=offset,
        sines=sines,
        period=1.0,
        periods=periods,
        sample_rate=rate,
        started_at=10.0 * number,
    )
    return Sweep(spec, Recording(time, np.asarray(effort), np.asarray(velocity), position))
