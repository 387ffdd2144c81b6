"""The service's lab against the virtual machine over socketcand: plan, run, identify, stop, export."""

import asyncio
import json
import math
import subprocess
import sys
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path

import pytest
import yaml

from drivers.ports import AxisState
from service.campaigns.plan import PlanRequest, build_plan
from service.cell import read_cell
from service.estimation import estimate_document
from service.identification import spectrum
from service.lab import Lab, open_lab
from service.settings import Settings
from service.store.bundle import read_bundle
from service.store.documents import CampaignDocument, CampaignState, RecordingState, SweepState
from service.store.guards import MachineTaken

ROOT = Path(__file__).resolve().parents[2]
TIMEOUT = 120.0  # s
AXES = ("joint_1", "joint_2", "joint_3")


@pytest.fixture
def profile(tmp_path: Path) -> Iterator[Path]:
    """A virtual machine, and the profile that leads to it."""
    command = [sys.executable, "-c", "from service.cli import main; main()", "drive"]
    command += ["--port", "0", "--control-port", "0", "--speed-factor", "20", "--seed", "1"]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        assert process.stdout is not None
        port = json.loads(process.stdout.readline())["port"]
        content = yaml.safe_load((ROOT / "config/drives/virtual-max100.yaml").read_text())
        content["bus"]["port"] = port
        content["eds"] = str(ROOT / "config/eds/virtual-axis.eds")
        path = tmp_path / "drive.yaml"
        path.write_text(yaml.safe_dump(content))
        try:
            yield path
        finally:
            process.terminate()


@pytest.fixture
def settings(profile: Path, tmp_path: Path) -> Settings:
    return Settings(
        data_dir=tmp_path / "data",
        drive=profile,
        robots_dir=ROOT / "config/robots",
        cells_dir=ROOT / "config/cells",
    )


@pytest.fixture
async def lab(settings: Settings) -> AsyncIterator[Lab]:
    async with open_lab(settings) as lab:
        yield lab


async def campaign_of(lab: Lab, modes: str) -> CampaignDocument:
    """Two poses, three axes."""
    robot = next(robot for robot in lab.store.robots() if robot.name == "max100-class")
    request = PlanRequest.model_validate(
        {"robot_id": robot.id, "axes": AXES, "varied": AXES[1:], "step": 30.0, "poses": 2, "modes": modes}
        | {"move_velocity": 0.5}
    )
    plan = build_plan(robot.build(), request, read_cell(lab.settings.cells_dir / "workshop.yaml"))
    record = lab.store.add_plan(robot.id, plan.model_dump(mode="json"))
    return await lab.add_campaign(record.id)


async def until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(TIMEOUT):
        while not condition():  # noqa: ASYNC110
            await asyncio.sleep(0.02)


async def standing(lab: Lab) -> bool:
    return all(axis.state is AxisState.DISABLED for axis in (await lab.machine.status()).values())


async def completed(lab: Lab, campaign_id: int) -> CampaignDocument:
    """Wait until nothing is left to do; fails at once with its cause when the campaign is held."""
    under_way = (CampaignState.RUNNING, CampaignState.MEASURED)
    await until(lambda: lab.store.campaign(campaign_id).state not in under_way)
    campaign = lab.store.campaign(campaign_id)
    assert (campaign.state, campaign.cause) == (CampaignState.COMPLETED, "")
    return campaign


async def test_a_campaign_from_plan_to_estimate_and_bundle(lab: Lab, tmp_path: Path) -> None:
    assert lab.machine.connected, lab.machine.trouble
    campaign = await campaign_of(lab, "drive_side")
    await lab.runner.start(campaign.id)
    done = await completed(lab, campaign.id)
    assert done.sweeps == {SweepState.IDENTIFIED: 6}
    assert await standing(lab)
    estimate = lab.store.estimate(campaign.id)
    assert estimate.revision == 6
    for joint in AXES:
        for sweep in estimate.document["axes"][joint]["inertia"]:
            assert sweep["value"] > 0
    await lab.export_bundle(campaign.id, tmp_path / "bundle")
    bundle = read_bundle(tmp_path / "bundle")
    offline = estimate_document(bundle.robot, [spectrum(bundle.robot, sweep) for sweep in bundle.sweeps])
    assert offline == estimate.document
    imported = await lab.import_bundle(tmp_path / "bundle")
    assert imported.plan_id is None
    await completed(lab, imported.id)
    assert lab.store.estimate(imported.id).document == estimate.document


async def test_both_ways_of_measuring_give_the_same_inertia(lab: Lab) -> None:
    """The drive's own measuring function against set-points streamed by us in real time, over the same bus."""
    documents = {}
    for modes in ("drive_side", "host_streamed"):
        campaign = await campaign_of(lab, modes)
        await lab.runner.start(campaign.id)
        await completed(lab, campaign.id)
        documents[modes] = lab.store.estimate(campaign.id).document["axes"]
    deviations = []
    for joint in AXES:
        pairs = zip(*(documents[modes][joint]["inertia"] for modes in documents), strict=True)
        for ours, theirs in pairs:
            std = math.hypot(ours["std"], theirs["std"])
            deviations.append((ours["value"] - theirs["value"]) / std)
            print(f"{joint}: {ours['value']:.2f} against {theirs['value']:.2f} kg m2, {deviations[-1]:+.2f} sigma")
    assert max(map(abs, deviations)) < 4


@pytest.mark.parametrize("modes", ["drive_side", "host_streamed"])
async def test_stop_in_a_sweep_leaves_standing_axes_and_a_partial_recording(lab: Lab, modes: str) -> None:
    campaign = await campaign_of(lab, modes)
    with lab.hub.subscribe(campaign.id) as live:
        await lab.runner.start(campaign.id)
        async with asyncio.timeout(TIMEOUT):
            await anext(live)  # samples flow: the axis moves
        stop = await lab.machine.stop("test", "hose caught")
    await asyncio.wait_for(lab.runner.finished(), TIMEOUT)
    assert await standing(lab)
    sweep = lab.store.sweep(campaign.id, 1)
    assert (sweep.state, sweep.cause) == (SweepState.INTERRUPTED, "stopped by test: hose caught")
    assert lab.store.campaign(campaign.id).state is CampaignState.PAUSED
    assert lab.store.recording(campaign.id, 1).state is RecordingState.PARTIAL
    assert lab.machine.latched == stop


async def test_a_second_service_on_the_same_data_is_refused(lab: Lab, settings: Settings) -> None:
    with pytest.raises(MachineTaken, match="stop that one first"):
        async with open_lab(settings):
            pytest.fail("two services own the machine")
    assert lab.machine.connected
