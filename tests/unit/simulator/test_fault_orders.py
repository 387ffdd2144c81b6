"""Orders of the control port: what is wrong is answered and changes nothing, whatever a client sends."""

import json
from collections.abc import Callable

import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from simulator import Scenario, load_scenario
from simulator.canopen.line import CanopenCabinet
from simulator.canopen.pdo import Frame
from simulator.control import ORDERS, OrderTarget, carry_out
from simulator.machine import LiveMachine
from tests.unit.simulator.conftest import CONFIG, EDS

JOINTS = [f"joint_{number}" for number in range(1, 7)]
FIELDS = sorted({field for order in ORDERS.values() for field in (*order.required, *order.optional)})


@pytest.fixture
def cabinet(scenario: Callable[[str], Scenario]) -> CanopenCabinet:
    sent: list[Frame] = []
    return CanopenCabinet(LiveMachine(scenario("rigid"), 1), EDS, 1.0, sent.append)


@pytest.fixture
def plant(cabinet: CanopenCabinet) -> OrderTarget:
    return OrderTarget(cabinet, None)


@pytest.fixture(scope="module")
def shared() -> OrderTarget:
    """For orders that are looked at alone: reading six EDS takes long."""
    machine = LiveMachine(load_scenario(CONFIG / "scenarios/max100-rigid.yaml"), 1)
    return OrderTarget(CanopenCabinet(machine, EDS, 1.0, lambda _: None), None)


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("no json", "Expecting value"),
        ("[1]", "JSON object"),
        ("[" * 60_000, "recursion"),
        ('{"order": "explode"}', "'explode' is not one of status, fault"),
        ('{"order": ["status"]}', "is not one of"),
        ('{"order": "status", "verbose": true}', "'verbose' is no field of the order status"),
        ('{"order": "fault", "joint": "joint_9", "code": 1}', "'joint_9' is not one of joint_1"),
        ('{"order": "fault", "joint": ["joint_1"], "code": 1}', "is not one of joint_1"),
        ('{"order": "fault", "joint": "joint_1", "code": 70000}', "code: 70000"),
        ('{"order": "fault", "joint": "joint_1", "code": true}', "code: True"),
        ('{"order": "fault", "joint": "joint_1", "code": 1, "at_sample": 1, "at_counter": 1}', "one of them at most"),
        ('{"order": "drop_tpdos", "joint": "joint_1"}', "count: missing in the order drop_tpdos"),
        ('{"order": "delay_tpdos", "joint": "joint_1", "count": 1, "cycles": 9999}', "cycles: 9999"),
        ('{"order": "emergency_stop", "on": 1}', "on: 1"),
        ('{"order": "glitch", "joint": "joint_1", "revolutions": NaN}', "revolutions: nan"),
        ('{"order": "glitch", "joint": "joint_1", "revolutions": 0}', "revolutions: 0"),
        ('{"order": "saturate", "joint": "joint_1"}', "torque_permille: missing"),
        ('{"order": "saturate", "joint": "joint_1", "torque_permille": -1}', "torque_permille: -1"),
        ('{"order": "swap", "joint": "joint_1", "with": "joint_1"}', "the same drive"),
        ('{"order": "swap", "joint": "joint_1", "with": "elbow"}', "with 'elbow' is not one of joint_1"),
        ('{"order": "bus_off"}', "not on this fieldbus"),
    ],
)
def test_bad_orders_name_the_field(shared: OrderTarget, line: str, reason: str) -> None:
    reply = carry_out(shared, line.encode())
    assert reply["ok"] is False
    assert reason in str(reply["error"])
    assert len(str(reply["error"])) < 400


def test_a_fault_waits_for_its_counter(cabinet: CanopenCabinet, plant: OrderTarget) -> None:
    order = {"order": "fault", "joint": "joint_1", "code": 0x7305, "at_counter": 3}
    assert carry_out(plant, json.dumps(order).encode()) == {"ok": True}
    states = []
    for cycle in range(3):
        cabinet.receive(Frame(0x80, b""), 0.004 * cycle)
        states.append(cabinet.nodes["joint_1"].axis.state.name)
    assert states == ["SWITCH_ON_DISABLED", "SWITCH_ON_DISABLED", "FAULT"]


def test_a_fault_without_an_instant_happens_now(cabinet: CanopenCabinet, plant: OrderTarget) -> None:
    assert carry_out(plant, b'{"order": "fault", "joint": "joint_2", "code": 29445}') == {"ok": True}
    assert cabinet.nodes["joint_2"].axis.state.name == "FAULT"


def anything() -> st.SearchStrategy[object]:
    simple = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20) | st.sampled_from(JOINTS)
    return simple | st.lists(simple, max_size=3) | st.dictionaries(st.text(max_size=5), simple, max_size=3)


def orders() -> st.SearchStrategy[bytes]:
    names = st.sampled_from(sorted(ORDERS)) | st.text(max_size=10)
    sensible = {
        "joint": st.sampled_from(JOINTS),
        "with": st.sampled_from(JOINTS),
        "on": st.booleans(),
        "code": st.integers(0, 0xFFFF),
    }
    fields = {field: sensible.get(field, st.integers(0, 500)) | anything() for field in FIELDS}
    return st.builds(
        lambda name, values: json.dumps({"order": name, **values}).encode(),
        names,
        st.fixed_dictionaries({}, optional=fields),
    ) | st.binary(max_size=200)


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(lines=st.lists(orders(), max_size=4))
def test_no_order_raises_or_moves_an_axis_that_nobody_enabled(
    cabinet: CanopenCabinet, plant: OrderTarget, lines: list[bytes]
) -> None:
    for line in lines:
        reply = carry_out(plant, line)
        assert reply["ok"] in (True, False)
        assert json.dumps(reply)
        cabinet.receive(Frame(0x80, b""), 0.0)
        cabinet.run(0.1)
    assert not any(node.axis.energised for node in cabinet.nodes.values())
    assert cabinet.cycles == 0


@pytest.mark.parametrize("order", sorted(ORDERS))
@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_every_order_with_the_right_fields_and_any_values(shared: OrderTarget, order: str, data: st.DataObject) -> None:
    fields = {field: data.draw(anything()) for field in (*ORDERS[order].required, *ORDERS[order].optional)}
    if "joint" in fields:
        fields["joint"] = "joint_1"
    assert carry_out(shared, json.dumps({"order": order, **fields}).encode())["ok"] in (True, False)
