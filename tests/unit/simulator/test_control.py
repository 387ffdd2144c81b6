import json
from collections.abc import Callable
from pathlib import Path

import pytest

from simulator import Scenario
from simulator.canopen.cabinet import Cabinet
from simulator.canopen.node import Frame
from simulator.control import carry_out
from simulator.machine import Machine

EDS = Path(__file__).parents[3] / "config/eds/virtual-axis.eds"


@pytest.fixture
def cabinet(scenario: Callable[[str], Scenario]) -> Cabinet:
    sent: list[Frame] = []
    return Cabinet(Machine(scenario("rigid"), 1), EDS, 1.0, sent.append)


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("no json", "Expecting value"),
        ("[1]", "JSON object"),
        ('{"order": "explode"}', "'explode' is none of status, fault"),
        ('{"order": ["status"]}', "is none of"),
        ('{"order": "fault", "joint": "joint_9", "code": 1}', "'joint_9' is none of joint_1"),
        ('{"order": "fault", "joint": ["joint_1"], "code": 1}', "is none of joint_1"),
        ('{"order": "fault", "joint": "joint_1", "code": 70000}', "code: 70000"),
        ('{"order": "fault", "joint": "joint_1", "code": true}', "code: True"),
        ('{"order": "drop_tpdos", "joint": "joint_1"}', "count: None"),
        ('{"order": "emergency_stop", "on": 1}', "on: 1"),
    ],
)
def test_bad_orders_name_the_field(cabinet: Cabinet, line: str, reason: str) -> None:
    reply = carry_out(cabinet, line.encode())
    assert reply["ok"] is False
    assert reason in str(reply["error"])


def test_a_fault_waits_for_its_counter(cabinet: Cabinet) -> None:
    order = {"order": "fault", "joint": "joint_1", "code": 0x7305, "at_counter": 3}
    assert carry_out(cabinet, json.dumps(order).encode()) == {"ok": True}
    states = []
    for cycle in range(3):
        cabinet.receive(Frame(0x80, b""), 0.004 * cycle)
        states.append(cabinet.nodes["joint_1"].axis.state.name)
    assert states == ["SWITCH_ON_DISABLED", "SWITCH_ON_DISABLED", "FAULT"]
