"""The cabinet of foreign drives as a machine: orders, buses, the command line, and any frames at all."""

import json
import re
import signal
import struct
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from simulator.canopen.line import ForeignCabinet
from simulator.canopen.pdo import Frame
from simulator.control import OrderTarget, carry_out
from simulator.machine import LiveMachine
from simulator.scenario import ScenarioError, load_scenario
from tests.command import sweepid
from tests.foreign_bench import PLAIN, ROOT, Foreign, bench, file_of
from tests.unit.simulator.foreign.conftest import RIGID, mastered
from tests.unit.simulator.foreign.master import ENABLE, Cycle, Master

pytestmark = pytest.mark.slow

VELOCITY = 0x60FF0000
OBJECTS = (0x1003, 0x1005, 0x1014, 0x1016, 0x1400, 0x1600, 0x1800, 0x1A00, 0x6060, 0x607A, 0x607D, 0x6085, 0x60C2)


@pytest.fixture
def cabinet() -> ForeignCabinet:
    machine = LiveMachine(load_scenario(RIGID), 0)
    cabinet = ForeignCabinet(machine, dict.fromkeys(machine.joints, file_of(PLAIN)), 1.0, lambda _: None)
    cabinet.boot()
    return cabinet


def test_on_socketcand_it_is_the_same_drive() -> None:
    with bench(bus="socketcand", scenario=RIGID) as foreign, mastered(foreign) as master:
        cycle = master.enabled(9, VELOCITY)
        assert cycle.run(ENABLE, 200_000, 100)[1] == pytest.approx(200_000, rel=0.05)


def test_orders_reach_the_drives(master: Master) -> None:
    order = master.foreign.order
    master.enabled(9, VELOCITY)
    order("emergency_stop", on=True)
    assert not master.truth()["energised"]
    assert master.number(0x603F) == 0x9000
    order("emergency_stop", on=False)
    order("emcy", joint="joint_1", code=0x4210)
    master.settle(lambda: 0x4210 in master.emergencies)
    order("identity", joint="joint_1", serial=77)
    assert master.number(0x1018, 4) == 77
    order("swap", joint="joint_1", **{"with": "joint_2"})
    assert master.number(0x1018, 4) != 77
    order("swap", joint="joint_1", **{"with": "joint_2"})
    assert master.number(0x1018, 4) == 77


@pytest.mark.parametrize(
    "order",
    [
        {"order": "fault", "joint": "joint_1", "code": 0x7305, "at_sample": 3},
        {"order": "glitch", "joint": "joint_1", "revolutions": 1.0, "at_sample": 3},
        {"order": "freeze_counter", "joint": "joint_1", "on": True},
    ],
    ids=lambda order: order["order"],
)
def test_what_only_the_virtual_drive_has_cannot_be_ordered(cabinet: ForeignCabinet, order: dict[str, object]) -> None:
    reply = carry_out(OrderTarget(cabinet, None), json.dumps(order).encode())
    assert reply == {"ok": False, "error": "not with this drive: it has neither trace nor sample counter"}


def test_a_fault_comes_with_a_counted_sync(master: Master) -> None:
    cycle = Cycle(master, VELOCITY)
    master.foreign.order("fault", joint="joint_1", code=0x7305, at_counter=3)
    cycle.sync()
    cycle.sync()
    assert master.number(0x603F) == 0
    cycle.sync()
    assert master.number(0x603F) == 0x7305


def test_a_joint_without_a_dictionary_is_told() -> None:
    machine = LiveMachine(load_scenario(RIGID), 0)
    with pytest.raises(ScenarioError, match=r"joint joint_1: no dictionary for its drive"):
        ForeignCabinet(machine, {}, 1.0, lambda _: None)
    with pytest.raises(ScenarioError, match=r"max100-rigid\.yaml: not an EDS or DCF"):
        ForeignCabinet(machine, dict.fromkeys(machine.joints, RIGID), 1.0, lambda _: None)


def command(*options: str) -> list[str]:
    start = [str(Path(sys.executable).with_name("sweepid")), "drive", "--scenario", str(RIGID), "--port", "0"]
    return [*start, *options]


def test_the_command_takes_a_dictionary_for_all_and_one_for_an_axis(tmp_path: Path) -> None:
    own = tmp_path / "own.dcf"
    own.write_text(re.sub(r"(?m)^ProductName=.*$", "ProductName=my own", file_of(PLAIN).read_text()))
    options = command("--foreign", str(file_of(PLAIN)), "--foreign", f"joint_2={own}")
    with subprocess.Popen(options, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, cwd=ROOT) as process:
        try:
            assert process.stdout is not None
            ready = json.loads(process.stdout.readline())
            bus = {"interface": "socketcand", "channel": "can0", "host": "127.0.0.1", "port": ready["port"]}
            foreign = Foreign(bus, ready["control_port"], dict.fromkeys(("joint_1", "joint_2"), file_of(PLAIN)))
            with mastered(foreign, "joint_2") as master:
                assert master.read(0x1008) == b"my own"
                assert foreign.truth("joint_2")["maker"] == "plain CiA 402"
        finally:
            process.send_signal(signal.SIGTERM)
    assert process.returncode == 0


@pytest.mark.parametrize("option", ["joint_9=config/eds/plain-402.eds", "config/scenarios/max100-full.yaml"])
def test_the_command_tells_what_is_no_dictionary(option: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    done = sweepid(*command("--foreign", option)[1:])
    assert done.returncode == 2
    assert re.search(r"--foreign: ('joint_9' is not one of|config/.*yaml is not an \.eds or \.dcf file)", done.stderr)


frames = st.builds(
    Frame,
    st.sampled_from([0, 0x80, 0x181, 0x201, 0x301, 0x601, 0x602, 0x70A]) | st.integers(0, 0x7FF),
    st.binary(max_size=8),
) | st.builds(
    lambda command, index, sub, data: Frame(0x601, struct.pack("<BHB", command, index, sub) + data),
    st.sampled_from([0x40, 0x21, 0x23, 0x2B, 0x2F, 0xA0, 0xA4]),
    st.sampled_from(OBJECTS),
    st.integers(0, 9),
    st.binary(min_size=4, max_size=4),
)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(stream=st.lists(frames, max_size=30))
def test_any_frames_at_all(cabinet: ForeignCabinet, stream: list[Frame]) -> None:
    """No crash; no axis has torque but one that the state table enabled."""
    for k, frame in enumerate(stream):
        cabinet.receive(frame, 0.01 * k)
        cabinet.run(0.01 * k)
    for joint, told in cabinet.status()["axes"].items():  # pyright: ignore[reportAttributeAccessIssue]
        assert told["energised"] is cabinet.nodes[joint].axis.energised
