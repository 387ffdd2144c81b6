"""Axes that move at once, by the service's application against the virtual machine over socketcand."""

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sweepid
from drivers.ports import AxisState
from service.identification.model import axis_rows, dynamic_base
from service.machine.execution.energising import Intention
from service.model.configuration import read_cell, read_robot
from service.planning.documents import PlanRequest, TrajectoryRequest
from service.planning.plan import build_plan
from service.planning.trajectories import build_trajectory_plan
from service.process.settings import Settings
from service.store.documents import CampaignDocument, CampaignState, SweepState
from service.web.application import Application, open_application
from simulator.rigid_body import true_inertia
from simulator.scenario import load_scenario
from tests.system.rest_bench import PATIENT_LEASE, VirtualMachine, virtual_machine

ROOT = Path(__file__).resolve().parents[2]
SCENARIO = ROOT / "config/scenarios/max100-six.yaml"
TIMEOUT = 120.0  # s


@pytest.fixture
def machine(tmp_path: Path) -> Iterator[VirtualMachine]:
    with virtual_machine(tmp_path, scenario=SCENARIO) as machine:
        yield machine


@pytest.fixture
def settings(machine: VirtualMachine, tmp_path: Path) -> Settings:
    return Settings(
        data_dir=tmp_path / "data",
        drive=machine.profile,
        robots_dir=ROOT / "config/robots",
        cells_dir=ROOT / "config/cells",
        lease_time=PATIENT_LEASE,
    )


@pytest.fixture
async def application(settings: Settings) -> AsyncIterator[Application]:
    async with open_application(settings) as application:
        yield application


async def planned(application: Application, kind: Any, build: Any, wanted: dict[str, object]) -> CampaignDocument:
    robot = next(robot for robot in application.store.robots() if robot.name == "max100-class")
    request = kind.model_validate({"robot_id": robot.id, "cell": "workshop", "move_velocity": 0.5} | wanted)
    cell = read_cell(application.settings.cells_dir / "workshop.yaml")
    plan = await asyncio.to_thread(build, robot.build(), request, cell)  # it may not hold up the watches
    record = application.store.add_plan(robot.id, plan.model_dump(mode="json"))
    return await application.add_campaign(record.id)


async def trajectory_of(application: Application, **changes: object) -> CampaignDocument:
    """One trajectory of two axes."""
    wanted = {"kind": "trajectory", "axes": ("joint_3", "joint_5"), "trajectories": 1, "period": 2.0, "harmonics": 3}
    return await planned(application, TrajectoryRequest, build_trajectory_plan, wanted | changes)


async def until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(TIMEOUT):
        while not condition():  # noqa: ASYNC110
            await asyncio.sleep(0.02)


async def standing(application: Application) -> bool:
    return all(axis.state is AxisState.DISABLED for axis in (await application.machine.status()).values())


async def completed(application: Application, campaign_id: int) -> CampaignDocument:
    """Wait until nothing is left to do; fails at once with its cause when the campaign is held."""
    under_way = (CampaignState.RUNNING, CampaignState.MEASURED)
    await until(lambda: application.store.campaign(campaign_id).state not in under_way)
    campaign = application.store.campaign(campaign_id)
    assert (campaign.state, campaign.cause) == (CampaignState.COMPLETED, "")
    await until(lambda: campaign_id not in application.checks.wanting(campaign_id))  # the last of its tasks
    return campaign


async def test_axes_that_move_at_once_are_identified_together(application: Application, tmp_path: Path) -> None:
    one = {"axes": ("joint_3",), "varied": ("joint_5",), "step": 30.0, "poses": 2, "modes": "drive_side"}
    alone = await planned(application, PlanRequest, build_plan, one)
    await application.runner.start(alone.id, Intention(application.machine.epochs.now))
    await completed(application, alone.id)
    campaign = await trajectory_of(application, sweeps=alone.id)
    await application.runner.start(campaign.id, Intention(application.machine.epochs.now))
    done = await completed(application, campaign.id)
    assert done.sweeps == {SweepState.IDENTIFIED: 2}
    assert await standing(application)
    first, second = (sweep.spec for sweep in application.store.sweeps(campaign.id))
    assert (first.started_at, first.block) == (second.started_at, "trajectory 1 of 2 axes")

    estimate: Any = application.store.estimate(campaign.id).document
    assert estimate["axes"].keys() == {"joint_3"}
    found = {parameter["name"]: parameter for parameter in estimate["combination"]["base_parameters"]}
    assert found["Fc(joint_3)"]["value"] == pytest.approx(75, rel=0.1)  # motor and load side of the scenario
    assert found["Fc(joint_5)"]["value"] == pytest.approx(23, rel=0.1)
    assert not found["Fc(joint_1)"]["identified"]
    await application.export_bundle(campaign.id, tmp_path / "bundle")
    offline: Any = sweepid.identify(tmp_path / "bundle").as_json()
    assert offline["axes"] == {}
    assert offline["combination"]["trajectories"] == estimate["combination"]["trajectories"] == [["0001", "0002"]]
    parts = {parameter["name"]: parameter for parameter in offline["combination"]["base_parameters"]}
    assert found["Fc(joint_3)"]["std"] < 1.5 * parts["Fc(joint_3)"]["std"]
    assert sum(p["identified"] for p in found.values()) >= sum(p["identified"] for p in parts.values())


async def test_simultaneous_sweeps_are_identified(application: Application) -> None:
    wanted = {"axes": ("joint_3", "joint_5"), "varied": ("joint_5",), "step": 30.0, "poses": 2, "simultaneous": True}
    campaign = await planned(application, PlanRequest, build_plan, wanted)
    await application.runner.start(campaign.id, Intention(application.machine.epochs.now))
    done = await completed(application, campaign.id)
    assert await standing(application)
    specs = [sweep.spec for sweep in application.store.sweeps(campaign.id)]
    assert done.sweeps == {SweepState.IDENTIFIED: len(specs)}
    assert {spec.axes_at_once for spec in specs} == {2}
    assert all(spec.offset_velocity for spec in specs)
    estimate: Any = application.store.estimate(campaign.id).document
    values = [parameter["value"] for parameter in estimate["combination"]["base_parameters"]]
    robot, poses = read_robot(ROOT / "config/robots/max100-class.yaml"), np.array([spec.pose for spec in specs])
    for joint in wanted["axes"]:
        rows = axis_rows(robot.chain, robot.index(joint), poses)
        rows = np.hstack([rows, np.zeros((len(rows), 3 * len(robot.axes)))])[:, dynamic_base(robot).columns]
        assert rows @ values == pytest.approx(true_inertia(load_scenario(SCENARIO), joint, poses), rel=0.03)


async def test_a_fault_on_a_trajectory_is_told_and_not_that_braking_axes_leave_it(
    application: Application, machine: VirtualMachine
) -> None:
    campaign = await trajectory_of(application)
    with application.hub.subscribe(campaign.id) as live:
        await application.runner.start(campaign.id, Intention(application.machine.epochs.now))
        async with asyncio.timeout(TIMEOUT):
            async for block in live:
                if block.time[-1] > 2.0:
                    break
        machine.order("fault", joint="joint_3", code=0x2310)
        await asyncio.wait_for(application.runner.finished(), TIMEOUT)
    states = {joint: axis.state for joint, axis in (await application.machine.status()).items()}
    assert states == dict.fromkeys(states, AxisState.DISABLED) | {"joint_3": AxisState.FAULT}
    done = application.store.campaign(campaign.id)
    assert done.state is CampaignState.PAUSED
    assert done.cause == "DriveFault: joint_3 (node 3): error 2310h, history 00002310h"
    assert {sweep.cause for sweep in application.store.sweeps(campaign.id)} == {done.cause}
