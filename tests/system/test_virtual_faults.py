"""Every fault to order, seen from a real CAN: what a host meets."""

import struct
from collections.abc import Iterator

import numpy as np
import pytest

from tests.system.virtual_bench import GEAR, Bench, Host, bench, until

TRACE = np.dtype(
    [("cycle", "<u4"), ("torque", "<f4"), ("command", "<f4"), ("speed", "<f4"), ("enc", "<f8"), ("enc2", "<f8")]
)
START = bytes([1, 0])  # NMT: all nodes operational
DONE = 2


@pytest.fixture
def machine() -> Iterator[Bench]:
    with bench() as running:
        yield running


@pytest.fixture
def host(machine: Bench) -> Host:
    return machine.host()


def counters(host: Host, syncs: int) -> list[list[int]]:
    """The sample counters that come with each SYNC, of node 1; a TPDO1 must go with each."""
    result: list[list[int]] = []
    for _ in range(syncs):
        host.frames.clear()
        host.send(0x80)
        host.read(1, 0x6041, 0, "H")  # answered after everything that the SYNC caused
        assert len(host.of(0x181)) == len(host.of(0x281))
        result.append([struct.unpack_from("<I", data, 4)[0] for data in host.of(0x281)])
    return result


def trace(host: Host, first: int, number: int) -> np.ndarray:
    """A page of node 1's trace, by segmented upload."""
    host.write(1, 0x2110, 1, "I", first)
    host.write(1, 0x2110, 2, "H", number)
    (size,) = struct.unpack_from("<I", host.request(1, struct.pack("<BHB4x", 0x40, 0x2110, 3)), 4)
    page, toggle = b"", 0
    while len(page) < size:
        page += host.request(1, bytes([0x60 | toggle]) + bytes(7))[1:]
        toggle ^= 0x10
    return np.frombuffer(page[:size], TRACE)


def stream(host: Host, cycles: int, speed: int) -> list[tuple[int, int, int]]:
    """(statusword, position, counter) of node 1 for each SYNC of mode 9 at a set-point in 10^-3 rev/min."""
    seen: list[tuple[int, int, int]] = []
    for _ in range(cycles):
        host.send(0x201, struct.pack("<Hi", 0x0F, speed))
        host.send(0x80)
        (status,) = struct.unpack_from("<H", host.wait_for(0x181))
        seen.append((status, *struct.unpack("<iI", host.wait_for(0x281))))
    return seen


def test_an_emergency_message_alone(machine: Bench, host: Host) -> None:
    host.enable(1, 1)
    machine.do("emcy", joint="joint_1", code=0x4210)
    assert host.wait_for(0x81) == struct.pack("<HB5x", 0x4210, 0)
    assert host.read(1, 0x6041, 0, "H") & 0x6F == 0x27
    assert host.read(1, 0x603F, 0, "H") == 0


def test_doubled_late_and_lost_tpdos(machine: Bench, host: Host) -> None:
    host.send(0, START)
    assert counters(host, 1) == [[1]]
    machine.do("duplicate_tpdos", joint="joint_1", count=2)
    assert counters(host, 3) == [[2, 2], [3, 3], [4]]
    machine.do("delay_tpdos", joint="joint_1", count=2, cycles=3)
    assert counters(host, 6) == [[], [], [7], [5, 8], [6, 9], [10]]
    machine.do("drop_tpdos", joint="joint_1", count=4)
    assert counters(host, 3) == [[], [], [13]]


@pytest.mark.parametrize("interface", ["socketcand", "virtual"])
def test_bus_off_is_told_once_and_the_axes_stop_by_themselves(interface: str) -> None:
    with bench(interface, factor=1.0) as machine:
        host = machine.host()
        host.write(1, 0x1016, 1, "I", 127 << 16 | 4000)
        host.send(0x77F, b"\x05")
        host.enable(1, 1)
        host.enable(3, 9)
        host.start_sweep(1, periods=60)
        until(lambda: machine.axis()["samples"] > 20)
        machine.do("bus_off")
        host.wait_for(0x40, error=True)
        host.frames.clear()
        host.send(0x77F, b"\x05")
        host.send(0x600 + 1, struct.pack("<BHB4x", 0x40, 0x6041, 0))
        until(lambda: machine.axis()["state"] == "fault")
        assert machine.axis()["fault"] == 0x8130
        assert not machine.axis()["energised"]
        assert host.receive(0.2) is None
        machine.do("bus_on")
        assert host.read(1, 0x6041, 0, "H") & 0x6F == 0x08
        assert host.of(0x81) == []  # what was said meanwhile is lost


def test_bus_off_while_streaming(machine: Bench, host: Host) -> None:
    host.write(1, 0x2121, 1, "H", 3000)  # ms without SYNC: a busy computer is no fault here
    host.enable(1, 9)
    host.send(0, START)
    stream(host, 20, 1000)
    machine.do("bus_off")
    until(lambda: machine.axis()["state"] == "fault")
    assert machine.axis()["fault"] == 0x8700
    assert not machine.axis()["energised"]


def test_the_limit_switch_holds_the_fault(machine: Bench, host: Host) -> None:
    host.enable(1, 1)
    host.write(1, 0x6081, 0, "I", 50_000)  # 10^-3 rev/min: the way takes some seconds at 20 times real time
    host.move(1, 70.0)
    until(lambda: machine.axis()["velocity"] > 0.02)
    machine.do("limit", joint="joint_1", on=True)
    assert host.wait_for(0x81) == struct.pack("<HB5x", 0xFF10, 0x21)
    until(lambda: machine.axis()["state"] == "fault")
    assert not machine.axis()["energised"]
    assert host.reset_fault(1) == 0x08
    host.send(0, bytes([129, 1]))  # a reset of the node does not clear the way either
    host.wait_for(0x701)
    assert host.read(1, 0x603F, 0, "H") == 0xFF10
    assert host.reset_fault(1) == 0x08
    machine.do("limit", joint="joint_1", on=False)
    assert host.reset_fault(1) == 0x40


def test_a_small_glitch_spoils_one_sample_unnoticed(machine: Bench, host: Host) -> None:
    host.enable(1, 1)
    machine.do("glitch", joint="joint_1", revolutions=0.25, at_sample=300)
    host.start_sweep(1)
    until(lambda: machine.axis()["measuring"] == "done")
    rows = trace(host, 290, 20)
    steps = np.diff(rows["enc"])
    assert np.flatnonzero(np.abs(steps) > 0.1).tolist() == [9, 10]
    assert steps[9] == pytest.approx(0.25, abs=0.01)
    assert np.flatnonzero(np.abs(rows["speed"]) > 1000).tolist() == [10]  # 0.25 rev in 4 ms
    assert np.abs(np.diff(rows["enc2"])).max() < 0.001
    assert host.read(1, 0x6041, 0, "H") & 0x6F == 0x27


def test_a_small_glitch_while_streaming(machine: Bench, host: Host) -> None:
    host.write(1, 0x2121, 1, "H", 10_000)
    host.enable(1, 9)
    host.send(0, START)
    stream(host, 10, 1000)
    machine.do("glitch", joint="joint_1", revolutions=-0.5)
    seen = stream(host, 10, 1000)
    steps = np.diff([position for _, position, _ in seen]) / 2**20
    assert np.flatnonzero(np.abs(steps) > 0.4).tolist() == [0, 1]
    assert {status & 0x6F for status, _, _ in seen} == {0x27}


def test_a_large_glitch_is_the_encoder_fault(machine: Bench, host: Host) -> None:
    host.enable(1, 1)
    machine.do("glitch", joint="joint_1", revolutions=1.5, at_sample=100)
    host.start_sweep(1, periods=50)
    assert host.wait_for(0x81) == struct.pack("<HB5x", 0x7305, 0x21)
    until(lambda: machine.axis()["state"] == "fault")
    assert machine.axis()["measuring"] == "aborted"


def test_a_weak_power_section_cannot_hold_the_arm(machine: Bench, host: Host) -> None:
    host.enable(2, 1)
    host.move(2, 4.0)  # leans forward: gravity must be held
    until(lambda: host.read(2, 0x6041, 0, "H") & 0x1400 == 0x1400)
    machine.do("saturate", joint="joint_2", torque_permille=10)
    assert host.wait_for(0x82) == struct.pack("<HB5x", 0x2310, 0x03)
    until(lambda: machine.axis("joint_2")["state"] == "fault")
    assert not machine.axis("joint_2")["energised"]
    machine.do("saturate", joint="joint_2", torque_permille=None)
    assert host.reset_fault(2) == 0x40
    host.enable(2, 1)
    host.move(2, 2.0)
    until(lambda: host.read(2, 0x6041, 0, "H") & 0x1400 == 0x1400)


def test_a_reboot_forgets_everything_but_the_place(machine: Bench, host: Host) -> None:
    host.write(1, 0x6085, 0, "I", 12345)
    host.write(1, 0x1017, 0, "H", 50)
    host.enable(1, 1)
    host.start_sweep(1, periods=50)
    until(lambda: machine.axis()["samples"] > 100)
    machine.do("reboot", joint="joint_1")
    while host.wait_for(0x701) != b"\0":  # heartbeats, then the boot-up message
        pass
    after = machine.axis()
    assert (after["energised"], after["state"], after["measuring"]) == (False, "switch_on_disabled", "idle")
    assert abs(after["position"]) > 0
    assert host.read(1, 0x6085, 0, "I") == 5_000_000
    assert host.read(1, 0x1017, 0, "H") == 0
    assert host.read(1, 0x6064, 0, "i") / 2**20 == pytest.approx(after["position"] * GEAR / (2 * np.pi), abs=1e-5)


def test_swapped_node_ids(machine: Bench, host: Host) -> None:
    def device(node: int) -> tuple[int, int]:
        return host.read(node, 0x1018, 4, "I"), host.read(node, 0x6076, 0, "I")

    first, second = device(1), device(2)
    assert (first[0], second[0]) == (1001, 1002)
    host.enable(1, 1)
    machine.do("swap", joint="joint_1", **{"with": "joint_2"})
    assert not machine.axis("joint_1")["energised"]
    host.frames.clear()
    assert (device(1), device(2)) == (second, first)
    host.enable(1, 1)
    host.move(1, 1.0)
    until(lambda: host.read(1, 0x6041, 0, "H") & 0x1400 == 0x1400)
    assert machine.axis("joint_2")["position"] > 0.01
    assert machine.axis("joint_1")["position"] == pytest.approx(0.0, abs=1e-3)
    host.send(0, START)
    host.frames.clear()
    host.send(0x80)
    host.read(6, 0x6041, 0, "H")
    assert len(host.of(0x181)) == len(host.of(0x182)) == 1


def test_safe_torque_off_in_the_middle_of_anything(machine: Bench, host: Host) -> None:
    for prepare in (lambda: host.start_sweep(1, periods=50), lambda: host.move(1, 20.0), lambda: None):
        host.enable(1, 1)
        prepare()
        until(lambda: machine.axis()["energised"])
        machine.do("emergency_stop", on=True)
        assert not machine.axis()["energised"]
        assert host.read(1, 0x6041, 0, "H") & 0x6F == 0x08
        assert host.read(1, 0x2130, 1, "B") == 1
        assert host.reset_fault(1) == 0x08
        machine.do("emergency_stop", on=False)
        assert host.reset_fault(1) == 0x40


def test_a_start_is_answered_when_the_state_is_the_new_one(machine: Bench, host: Host) -> None:
    host.enable(1, 1)
    for _ in range(2):
        host.start_sweep(1, periods=40)  # 2 s at 20 times real time
        assert host.read(1, 0x2100, 2, "H") != DONE
        until(lambda: machine.axis()["measuring"] == "done")
    host.write(1, 0x6040, 0, "H", 0)
    host.start_sweep(1)
    assert host.read(1, 0x2100, 2, "H") == 4  # rejected: not enabled


def test_a_drive_that_another_eds_describes() -> None:
    with bench(eds="virtual-axis-rpm", factor=2.0) as machine:
        host = machine.host()
        assert host.read(1, 0x1018, 2, "I") == 0x403
        assert host.read(1, 0x60A9, 0, "I") == 0x00B44700
        assert host.read(1, 0x605A, 0, "h") == 6
        assert host.write(1, 0x605A, 0, "h", 2) == 0x06090032
        host.enable(1, 1)
        assert host.write(1, 0x6081, 0, "I", 100) == 0  # rev/min
        host.move(1, 10.0)  # 3 s
        until(lambda: host.read(1, 0x606C, 0, "i") == pytest.approx(100, abs=2))
        until(lambda: host.read(1, 0x6041, 0, "H") & 0x1400 == 0x1400)
        assert machine.axis()["position"] == pytest.approx(10.0 / GEAR * 2 * np.pi, abs=1e-4)
        host.write(1, 0x6040, 0, "H", 0x02)
        assert host.read(1, 0x6041, 0, "H") & 0x6F == 0x07  # and there it stays


def test_a_drive_without_limits_says_so() -> None:
    with bench(eds="virtual-axis-no-limits") as machine:
        host = machine.host()
        assert host.read(1, 0x1018, 2, "I") == 0x402
        for index, sub in ((0x6072, 0), (0x607F, 0), (0x6080, 0), (0x607D, 1), (0x607D, 2)):
            assert host.write(1, index, sub, "I", 1) == 0x06020000
        host.enable(1, 1)
        host.move(1, 1.0)
        until(lambda: host.read(1, 0x6041, 0, "H") & 0x1400 == 0x1400)


def test_wrong_or_misspelt_orders_change_nothing(machine: Bench) -> None:
    reply = machine.order("fault", joint="joint_1", code=0x7305, at_smaple=3)
    assert reply == {"ok": False, "error": "'at_smaple' is no field of the order fault"}
    assert machine.axis()["state"] == "switch_on_disabled"
