"""A small data folder as a service leaves it: two identified sweeps, one planned, their files."""

import json
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from service.model import Recording, Sweep, SweepSpec
from service.model.configuration import read_robot
from service.planning.campaigns.state_machine import SweepEvent, sweep_move
from service.store.database import open_database
from service.store.documents import NewSweep
from service.store.examination import examine
from service.store.files.bundle import Bundle, save_bundle
from service.store.files.data_folder import claim_folder, import_campaign
from service.store.files.recordings import RecordingFiles
from service.store.store import Store

ROBOT = Path(__file__).parents[4] / "config" / "robots" / "max100-class.yaml"
SAMPLES = 10_000

Forks = Callable[[dict[str, Any]], dict[str, Any]]


def spec(number: int) -> SweepSpec:
    return SweepSpec(id=f"{number:04d}", axis="joint_1", pose=(0.0,) * 6, offset_velocity=0.01, sample_rate=1000.0)


@pytest.fixture(scope="session")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Nobody may change this one: `data` is a copy of it."""
    folder = tmp_path_factory.mktemp("measured") / "data"
    folder.mkdir()
    files, robot, noise = RecordingFiles(folder), read_robot(ROBOT), np.random.default_rng(1)
    sweeps = tuple(
        Sweep(spec(n), Recording(np.arange(SAMPLES) / 1000.0, *noise.normal(size=(3, SAMPLES)))) for n in (1, 2)
    )
    with open_database(f"sqlite:///{folder / 'sweepid.sqlite'}") as database:
        claim_folder(folder, database)
        store = Store(database)
        campaign = import_campaign(store, files, save_bundle(files, Bundle(robot, sweeps)))
        for sweep in store.sweeps(campaign.id):
            document: Any = {"a": 0.1 * sweep.number}
            spectrum = files.save_spectrum(store.recording(campaign.id, sweep.number).path, document)
            store.add_estimate([(sweep, spectrum)], sweep_move(SweepEvent.IDENTIFY), {"value": 1 / 3 * sweep.number})
        plan = store.add_plan(campaign.robot_id, {"any": "document"})
        store.add_campaign(plan.id, [NewSweep(spec=spec(1), mode=None)])
    return folder


@pytest.fixture
def data(measured: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(measured, tmp_path / "data"))


@pytest.fixture
def recording(data: Path) -> Path:
    """One of the recordings of `data`."""
    return sorted(data.glob("recordings/*/*.parquet"))[0]


@pytest.fixture
def findings(data: Path) -> Callable[[], list[tuple[str, str]]]:
    """What `doctor` finds in `data` now: places within, and what."""

    def find() -> list[tuple[str, str]]:
        found = examine(data / "sweepid.sqlite", data, 0)
        return [(one.place.removeprefix(f"{data}/"), one.what) for one in found]

    return find


@pytest.fixture(scope="session")
def forks() -> Iterator[Forks]:
    """Runs commands as `forks.py` says."""
    command = [sys.executable, "-m", "tests.unit.service.backup.forks"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:

        def ask(order: dict[str, Any]) -> dict[str, Any]:
            assert process.stdin is not None
            assert process.stdout is not None
            process.stdin.write(json.dumps(order) + "\n")
            process.stdin.flush()
            return json.loads(process.stdout.readline())

        yield ask


def contents(folder: Path) -> dict[str, bytes]:
    """Every file below a folder."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
