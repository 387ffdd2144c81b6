"""A campaign of three axes through the whole service on drives of other makers gives the inertias of the virtual drive.

The same plant stands behind all of them; the virtual drive sweeps by itself, the makers' follow the host's set-points.
Their dictionaries are read from ../shared; without that folder the tests are skipped.
"""

import asyncio
import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from drivers.registry import load_profile
from service.machine.execution.permission import Intention
from service.model.configuration import read_cell
from service.planning.documents import PlanRequest
from service.planning.plan import build_plan
from service.process.settings import Settings
from service.store.documents import CampaignState
from service.web.application import open_application
from tests.contract.makers import DEVICES, profile
from tests.foreign_bench import ROOT, Foreign, file_of

CONFIG = ROOT / "config"
DRIVES = CONFIG / "drives"
AXES = ("joint_1", "joint_2", "joint_3")
POSES = 2
WITHIN = 3.3  # standard deviations of a difference: one of a thousand lies further out
PERIODS = {"epos4": 0.008, "powerball": 0.004}  # s; positions make stairs, which bias J at 8 ms
TIMEOUT = 500.0  # s, of a campaign in real time

Inertias = dict[str, list[tuple[float, float]]]  # by axis: value and standard deviation of each sweep, kg m^2


@contextmanager
def machine(folder: Path, kind: str = "") -> Iterator[Path]:
    """A virtual machine in a process of its own, with another maker's drives if one is named; the profile to it."""
    eds = file_of(kind) if kind else CONFIG / "eds" / "virtual-axis.eds"
    command = [sys.executable, "-c", "from service.cli import main; main()", "drive", "--port", "0", "--seed", "1"]
    command += ["--foreign" if kind else "--eds", str(eds)]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        try:
            assert process.stdout is not None
            bus = {"interface": "socketcand", "channel": "can0", "host": "127.0.0.1"}
            bus["port"] = json.loads(process.stdout.readline())["port"]
            content: dict[str, Any] = load_profile(DRIVES / "virtual-max100.yaml")
            content |= {"eds": str(eds), "bus": content["bus"] | bus}
            if kind:
                files = dict.fromkeys([axis["joint"] for axis in content["axes"]], eds)
                content = profile(kind, Foreign(bus, 0, files), DRIVES, patient=True, sync_period=PERIODS[kind])
                content["device"] = str(CONFIG / "devices" / f"{DEVICES[kind]}.yaml")
            path = folder / f"{kind or 'virtual'}.yaml"
            path.write_text(yaml.safe_dump(content))
            yield path
        finally:
            process.terminate()


async def measured(drive: Path, data: Path, modes: str) -> Inertias:
    """A campaign from plan to estimate."""
    settings = Settings(data_dir=data, drive=drive, robots_dir=CONFIG / "robots", cells_dir=CONFIG / "cells")
    async with open_application(settings) as application:
        assert application.machine.connected, application.machine.trouble
        robot = next(robot for robot in application.store.robots() if robot.name == "max100-class")
        wanted = {
            "robot_id": robot.id,
            "cell": "workshop",
            "axes": AXES,
            "varied": AXES[1:],
            "step": 30.0,
            "poses": POSES,
        }
        request = PlanRequest.model_validate(wanted | {"modes": modes, "move_velocity": 0.5})
        plan = build_plan(robot.build(), request, read_cell(settings.cells_dir / "workshop.yaml"))
        campaign = await application.add_campaign(application.store.add_plan(robot.id, plan.model_dump(mode="json")).id)
        await application.runner.start(campaign.id, Intention(application.machine.epochs.now))
        async with asyncio.timeout(TIMEOUT):
            while application.store.campaign(campaign.id).state in (CampaignState.RUNNING, CampaignState.MEASURED):  # noqa: ASYNC110
                await asyncio.sleep(0.1)
        done = application.store.campaign(campaign.id)
        assert f"{done.state.value}: {done.cause}" == "completed: "
        document: Any = application.store.estimate(campaign.id).document
        return {joint: [(one["value"], one["std"]) for one in document["axes"][joint]["inertia"]] for joint in AXES}


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> Inertias:
    """By the virtual drive's own sweeps."""
    folder = tmp_path_factory.mktemp("own")
    with machine(folder) as drive:
        return asyncio.run(measured(drive, folder / "data", "drive_side"))


@pytest.mark.parametrize("kind", ["epos4", "powerball"])
def test_a_campaign_on_makers_drives_gives_the_inertias_of_the_virtual_drive(
    kind: str, own: Inertias, tmp_path: Path
) -> None:
    with machine(tmp_path, kind) as drive:
        found = asyncio.run(measured(drive, tmp_path / "data", "host_streamed"))
    for joint in AXES:
        assert len(found[joint]) == len(own[joint]) == POSES
        pairs = np.array([(*one, *other) for one, other in zip(found[joint], own[joint], strict=True)])
        differences, stds = pairs[:, 0] - pairs[:, 2], np.hypot(pairs[:, 1], pairs[:, 3])
        bias, least = 100 * float(np.mean(differences / pairs[:, 2])), 100 * float(np.max(stds / pairs[:, 2]))
        z = differences / stds
        print(f"{kind} {joint}: bias {bias:+.3f} %, std of a difference up to {least:.3f} %, z {np.round(z, 1)}")
        assert np.all(np.abs(z) <= WITHIN)
