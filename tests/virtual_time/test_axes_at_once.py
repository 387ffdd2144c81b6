"""Axes that move at once: trajectories and simultaneous sweeps of the six-axis machine, by the service."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sweepid
from service.identification.model import axis_rows, dynamic_base
from service.model.configuration import read_robot
from service.store.files.bundle import read_from
from simulator.rigid_body import true_inertia
from simulator.scenario import load_scenario
from tests.virtual_time.clock import Clock
from tests.virtual_time.machine import CONFIG, VirtualMachine
from tests.virtual_time.service import VirtualService, add_campaign

SCENARIO = CONFIG / "scenarios" / "max100-six.yaml"
ONE = {"axes": ["joint_3"], "varied": ["joint_5"], "modes": "drive_side"}
TWO = {"axes": ["joint_3", "joint_5"]}


@pytest.fixture
def machine(clock: Clock, tmp_path: Path) -> VirtualMachine:
    del clock
    return VirtualMachine(tmp_path, scenario=SCENARIO)


def trajectory(service: VirtualService, **more: object) -> int:
    """A campaign of one trajectory of two axes."""
    (robot,) = (each["id"] for each in service.client.robots() if each["name"] == "max100-class")
    wanted = {"kind": "trajectory", "robot_id": robot, **TWO, "trajectories": 1, "period": 2.0, "harmonics": 3}
    plan = service.client.add_plan(wanted | {"move_velocity": 0.5} | more)
    return int(service.client.add_campaign(plan["id"])["id"])


def measured(service: VirtualService, clock: Clock, number: int) -> dict[str, Any]:
    service.client.start(number)
    clock.wait_until(lambda: service.client.campaign(number)["state"] != "running", "over", 600.0, 1.0)
    clock.wait_until(lambda: service.client.campaign(number)["state"] == "completed", "completed", 60.0, 1.0)
    return service.client.estimate(number)["document"]["combination"]


def test_a_trajectory_is_identified_with_sweeps_and_alone(
    service: VirtualService, machine: VirtualMachine, clock: Clock, tmp_path: Path
) -> None:
    alone = add_campaign(service, poses=2, **ONE)
    measured(service, clock, alone)
    number = trajectory(service, sweeps=alone)
    together = measured(service, clock, number)
    assert service.client.campaign(number)["sweeps"] == {"identified": 2}
    assert machine.stands()
    first, second = (sweep["spec"] for sweep in service.client.sweeps(number))
    assert first["started_at"] == second["started_at"]

    assert service.client.estimate(number)["document"]["axes"].keys() == {"joint_3"}
    found = {parameter["name"]: parameter for parameter in together["base_parameters"]}
    assert found["Fc(joint_3)"]["value"] == pytest.approx(75, rel=0.1)  # motor and load side of the scenario
    assert found["Fc(joint_5)"]["value"] == pytest.approx(23, rel=0.1)
    assert not found["Fc(joint_1)"]["identified"]
    service.client.export_bundle(number, tmp_path / "bundle.zip")
    offline: Any = sweepid.identify(read_from(tmp_path / "bundle.zip", tmp_path / "bundle")).as_json()
    assert offline["axes"] == {}
    assert offline["combination"]["trajectories"] == together["trajectories"] == [["0001", "0002"]]
    parts = {parameter["name"]: parameter for parameter in offline["combination"]["base_parameters"]}
    assert found["Fc(joint_3)"]["std"] < 1.5 * parts["Fc(joint_3)"]["std"]
    assert sum(p["identified"] for p in found.values()) >= sum(p["identified"] for p in parts.values())


def test_simultaneous_sweeps_give_the_true_inertia(
    service: VirtualService, machine: VirtualMachine, clock: Clock
) -> None:
    number = add_campaign(service, poses=2, **TWO, varied=["joint_5"], simultaneous=True)
    values = [parameter["value"] for parameter in measured(service, clock, number)["base_parameters"]]
    assert machine.stands()
    specs = [sweep["spec"] for sweep in service.client.sweeps(number) if sweep["state"] == "identified"]
    assert service.client.campaign(number)["sweeps"] == {"identified": len(specs)}
    assert 2 * len({spec["started_at"] for spec in specs}) == len(specs)
    robot, poses = read_robot(CONFIG / "robots" / "max100-class.yaml"), np.array([spec["pose"] for spec in specs])
    for joint in TWO["axes"]:
        rows = axis_rows(robot.chain, robot.index(joint), poses)
        rows = np.hstack([rows, np.zeros((len(rows), 3 * len(robot.axes)))])[:, dynamic_base(robot).columns]
        assert rows @ values == pytest.approx(true_inertia(load_scenario(SCENARIO), joint, poses), rel=0.03)


@pytest.mark.parametrize(
    ("order", "joint", "told"),
    [
        ("fault", "joint_3", r"DriveFault: joint_3 \(node 3\): error 2310h, history 00002310h"),
        (
            "silence",
            "joint_3",
            r"CommunicationLost: joint_3 \(node 3\): no sample .*; the stop is not confirmed: joint_3: .*",
        ),
        ("silence", "joint_1", "CommunicationLost: node 1: no heartbeat .*; the stop is not confirmed: joint_1: .*"),
    ],
)
def test_the_cause_is_told_and_not_that_braking_axes_leave_the_trajectory(
    service: VirtualService, machine: VirtualMachine, clock: Clock, order: str, joint: str, told: str
) -> None:
    number = trajectory(service)
    service.client.start(number)
    clock.wait_until(lambda: len(machine.energised()) == 2, "two axes have energy", 60.0)
    clock.sleep(2.0)
    machine.order(order, joint=joint, **({"code": 0x2310} if order == "fault" else {"on": True}))
    clock.wait_until(lambda: service.client.campaign(number)["state"] == "paused", "paused", 60.0, 0.1)
    assert machine.stands()
    axes = {axis["joint"]: axis["state"] for axis in service.client.drives()["axes"]}
    lost = order == "silence"
    assert axes == dict.fromkeys(axes, "unknown" if lost else "disabled") | ({} if lost else {joint: "fault"})
    cause = service.client.campaign(number)["cause"]
    assert re.fullmatch(told, cause)
    assert {sweep["cause"] for sweep in service.client.sweeps(number)} == {cause}
