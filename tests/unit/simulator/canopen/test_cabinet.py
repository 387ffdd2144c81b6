"""Nodes and machine on one clock: frames and times in, frames out. The machine is the real (rigid) one."""

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import structlog.testing

from simulator import Scenario
from simulator.canopen.line import CanopenCabinet
from simulator.canopen.pdo import Frame
from simulator.control import OrderTarget, carry_out
from simulator.machine import LiveMachine

EDS = Path(__file__).parents[4] / "config/eds/virtual-axis.eds"
TRACE = np.dtype(
    [("cycle", "<u4"), ("torque", "<f4"), ("command", "<f4"), ("speed", "<f4"), ("enc", "<f8"), ("enc2", "<f8")]
)
GEAR = 171.0  # of joint_1


class Bench:
    """A cabinet with a clock in the test's hand."""

    def __init__(self, machine: LiveMachine, speed_factor: float) -> None:
        self.sent: list[Frame] = []
        self.now = 1000.0
        self.machine = machine
        self.cabinet = CanopenCabinet(machine, EDS, speed_factor, self.sent.append)
        self.cabinet.boot()
        self.booted = self.take()

    def take(self) -> list[Frame]:
        sent, self.sent[:] = list(self.sent), []
        return sent

    def frame(self, identifier: int, data: bytes = b"") -> list[Frame]:
        self.cabinet.receive(Frame(identifier, data), self.now)
        return self.take()

    def write(self, node: int, index: int, subindex: int, layout: str, value: float) -> None:
        data = struct.pack("<" + layout, value)
        command = 0x23 | (4 - len(data)) << 2
        sent = self.frame(0x600 + node, struct.pack("<BHB", command, index, subindex) + data.ljust(4, b"\0"))
        (answer,) = (frame.data for frame in sent if frame.id == 0x580 + node)
        assert answer[0] == 0x60, answer.hex()

    def enable(self, node: int, mode: int) -> None:
        self.write(node, 0x6060, 0, "b", mode)
        for controlword in (6, 7, 15):
            self.write(node, 0x6040, 0, "H", controlword)

    def wait(self, seconds: float, step: float = 0.001) -> list[Frame]:
        frames: list[Frame] = []
        for _ in range(round(seconds / step)):
            self.now += step
            self.cabinet.run(self.now)
            frames += self.take()
        return frames

    def axis(self, joint: str = "joint_1") -> dict[str, Any]:
        axes: Any = self.cabinet.status()["axes"]
        return axes[joint]

    def held(self, index: int, subindex: int = 0, joint: str = "joint_1") -> float:
        """The value of an object."""
        return float(self.cabinet.nodes[joint].dictionary[index, subindex])

    def state(self, joint: str = "joint_1") -> tuple[str, bool]:
        return self.axis(joint)["state"], self.axis(joint)["energised"]

    def order(self, order: str, joint: str | None = "joint_1", **fields: object) -> None:
        request = {"order": order, **fields} | ({} if joint is None else {"joint": joint})
        assert carry_out(OrderTarget(self.cabinet, None), json.dumps(request).encode()) == {"ok": True}

    def move(self, node: int, revolutions: float) -> None:
        self.write(node, 0x607A, 0, "i", round(revolutions * 2**20))
        self.write(node, 0x6040, 0, "H", 0x0F)
        self.write(node, 0x6040, 0, "H", 0x1F)

    def measure(self, periods: int = 2) -> None:
        """joint_1 at 0.1 rad/s with two sines: one second beside the periods of one, 4 ms a sample."""
        dictionary = self.cabinet.nodes["joint_1"].dictionary
        for sub, value in {4: 0.1 * GEAR, 5: 0.25, 6: 0.5, 7: 1.0, 8: periods, 9: 2, 0x0A: 4}.items():
            dictionary[0x2100, sub] = value
        for sub, frequency in enumerate((2.0, 5.0), 1):
            dictionary[0x2101, sub], dictionary[0x2102, sub] = frequency, 5.0
        self.write(1, 0x2100, 1, "H", 1)

    def reset_fault(self) -> object:
        for controlword in (0, 0x80):
            self.write(1, 0x6040, 0, "H", controlword)
        return self.axis()["state"]

    def counters(self, syncs: int) -> list[list[int]]:
        """The sample counters of node 1 that come with each SYNC; a TPDO1 goes with each."""
        told: list[list[int]] = []
        for _ in range(syncs):
            sent = self.frame(0x80)
            told.append([struct.unpack_from("<I", frame.data, 4)[0] for frame in sent if frame.id == 0x281])
            assert sum(frame.id == 0x181 for frame in sent) == len(told[-1])
        return told

    def stream(self, cycles: int, speed: int) -> list[tuple[int, int]]:
        """Statusword and position of node 1 for each SYNC of mode 9."""
        seen: list[tuple[int, int]] = []
        for _ in range(cycles):
            self.frame(0x201, struct.pack("<Hi", 0x0F, speed))
            sent = {frame.id: frame.data for frame in self.frame(0x80)}
            seen.append((struct.unpack_from("<H", sent[0x181])[0], struct.unpack_from("<i", sent[0x281])[0]))
        return seen


@pytest.fixture
def bench(scenario: Callable[[str], Scenario]) -> Bench:
    return Bench(LiveMachine(scenario("rigid"), 1), speed_factor=5.0)


def test_boots_six_nodes_that_stand(bench: Bench) -> None:
    assert bench.booted == [Frame(0x700 + node, b"\0") for node in range(1, 7)]
    assert bench.wait(0.1) == []
    assert bench.cabinet.status()["plant_time"] == 0.0
    assert bench.cabinet.due(bench.now) == float("inf")


def test_process_data_flow_in_operational_only(bench: Bench) -> None:
    assert bench.frame(0x80) == []
    bench.frame(0, b"\x01\x02")
    sent = bench.frame(0x80)
    assert [frame.id for frame in sent] == [0x182, 0x282]
    assert struct.unpack("<iI", sent[1].data) == (0, 2)
    bench.frame(0, b"\x01\x00")
    assert [frame.id for frame in bench.frame(0x80)] == [id_ + n for n in range(1, 7) for id_ in (0x180, 0x280)]
    bench.frame(0, b"\x80\x00")
    assert bench.frame(0x80) == []


def test_a_tpdo_of_type_3_comes_with_every_third_sync(bench: Bench) -> None:
    bench.write(1, 0x1801, 2, "B", 3)
    bench.frame(0, b"\x01\x01")
    assert [len(bench.frame(0x80)) for _ in range(6)] == [1, 1, 2, 1, 1, 2]


def test_heartbeats_at_their_time(bench: Bench) -> None:
    bench.write(4, 0x1017, 0, "H", 20)
    frames = bench.wait(0.11)
    assert [frame for frame in frames if frame.id == 0x704] == [Frame(0x704, b"\x7f")] * 6
    assert bench.cabinet.due(bench.now) <= 0.02


def test_each_sync_is_one_cycle_of_the_machine(bench: Bench) -> None:
    bench.enable(1, 9)
    bench.frame(0, b"\x01\x01")
    for _ in range(10):
        bench.frame(0x201, struct.pack("<Hi", 0x0F, 60_000))
        bench.frame(0x80)
    assert bench.cabinet.status()["plant_time"] == pytest.approx(0.04)
    bench.wait(0.05)
    assert bench.cabinet.status()["plant_time"] == pytest.approx(0.04)
    sent = bench.wait(0.2)  # SYNC is missing
    assert struct.pack("<HB", 0x8700, 0x11) in [frame.data[:3] for frame in sent if frame.id == 0x81]
    assert bench.state() == ("fault", False)
    assert bench.cabinet.due(bench.now) == float("inf")


def test_moves_run_faster_than_real_time_and_standing_does_not(bench: Bench) -> None:
    bench.enable(2, 1)
    bench.wait(0.2)
    assert bench.cabinet.status()["plant_time"] == pytest.approx(0.2, abs=0.03)
    bench.move(2, 10.0)
    bench.wait(0.1)
    assert bench.cabinet.status()["plant_time"] == pytest.approx(0.7, abs=0.03)


def test_a_slow_computer_slows_the_clock_of_the_machine_and_says_so_once(bench: Bench) -> None:
    bench.enable(2, 1)
    bench.wait(0.2)
    bench.move(2, 10.0)
    with structlog.testing.capture_logs() as logs:
        bench.wait(30.0, step=0.2)  # of which 0.004 s a step can be computed: not even real time
    assert [log["event"] for log in logs] == ["too slow: the machine's clock runs slower than asked"]
    assert bench.cabinet.cycles < 2000  # ms
    assert bench.axis("joint_2")["state"] == "operation_enabled"
    bench.wait(1.0)
    assert bench.held(0x6064, joint="joint_2") / 2**20 == pytest.approx(10.0, abs=0.01)


def test_an_rpdo_that_is_too_short_is_ignored(bench: Bench) -> None:
    bench.frame(0, b"\x01\x01")
    for data, state in ((b"\x06\x00", "switch_on_disabled"), (struct.pack("<Hi", 0x06, 0), "ready_to_switch_on")):
        bench.frame(0x201, data)
        bench.frame(0x80)
        assert bench.axis()["state"] == state


def test_leaving_operational_is_a_quick_stop(bench: Bench) -> None:
    bench.frame(0, b"\x01\x02")
    bench.enable(2, 1)
    bench.move(2, 20.0)
    bench.wait(0.1)
    assert bench.axis("joint_2")["velocity"] > 0.01
    bench.frame(0, b"\x80\x02")
    bench.wait(0.3)
    assert bench.state("joint_2") == ("switch_on_disabled", False)
    bench.enable(2, 1)
    bench.frame(0, b"\x81\x02")
    assert not bench.axis("joint_2")["energised"]


@pytest.mark.parametrize(
    ("option", "state"), [(0, "operation_enabled"), (1, "fault"), (2, "switch_on_disabled"), (3, "switch_on_disabled")]
)
def test_the_lost_host_by_6007(bench: Bench, option: int, state: str) -> None:
    bench.write(1, 0x6007, 0, "h", option)
    bench.write(1, 0x1016, 1, "I", 127 << 16 | 100)
    bench.enable(1, 1)
    bench.wait(0.3)
    assert bench.axis("joint_1")["state"] == "operation_enabled"  # no heartbeat yet: not monitored
    for _ in range(5):
        bench.frame(0x77F, b"\x05")
        bench.wait(0.05)
    assert bench.axis("joint_1")["state"] == "operation_enabled"
    bench.wait(0.4)
    assert bench.axis("joint_1")["state"] == state


def test_a_locked_axis_has_no_power(bench: Bench) -> None:
    bench.enable(4, 1)
    assert bench.axis("joint_4")["fault"] == 0x5400
    assert not bench.axis("joint_4")["energised"]


# -- faults to order


def test_an_emergency_message_alone_is_no_fault(bench: Bench) -> None:
    bench.enable(1, 1)
    bench.order("emcy", code=0x4210)
    assert Frame(0x81, struct.pack("<HB5x", 0x4210, 0)) in bench.wait(0.01)
    assert bench.state() == ("operation_enabled", True)
    assert bench.held(0x603F) == 0


def test_doubled_late_lost_and_frozen_tpdos(bench: Bench) -> None:
    bench.frame(0, b"\x01\x01")
    assert bench.counters(1) == [[1]]
    bench.order("duplicate_tpdos", count=2)
    assert bench.counters(3) == [[2, 2], [3, 3], [4]]
    bench.order("delay_tpdos", count=2, cycles=3)
    assert bench.counters(6) == [[], [], [7], [5, 8], [6, 9], [10]]
    bench.order("drop_tpdos", count=4)  # two TPDOs a SYNC
    assert bench.counters(3) == [[], [], [13]]
    bench.order("freeze_counter", on=True)
    assert bench.counters(2) == [[13], [13]]


def test_the_limit_switch_holds_the_fault_also_over_a_reset(bench: Bench) -> None:
    bench.enable(1, 1)
    bench.move(1, 70.0)
    bench.wait(0.2)
    assert bench.axis()["velocity"] > 0.02
    bench.order("limit", on=True)
    assert Frame(0x81, struct.pack("<HB5x", 0xFF10, 0x21)) in bench.wait(0.5)
    assert bench.state() == ("fault", False)
    assert bench.reset_fault() == "fault"
    bench.frame(0, bytes([129, 1]))
    bench.wait(0.01)
    assert bench.held(0x603F) == 0xFF10
    assert bench.reset_fault() == "fault"
    bench.order("limit", on=False)
    assert bench.reset_fault() == "switch_on_disabled"


@pytest.mark.parametrize("at", [{"at_sample": 300}, {}], ids=["a sample", "the next"])
def test_a_small_glitch_spoils_one_sample_unnoticed(bench: Bench, at: dict[str, Any]) -> None:
    bench.enable(1, 1)
    bench.measure()
    bench.wait(0.2)
    recorded = bench.axis()["samples"]
    assert 200 < recorded < 300
    bench.order("glitch", revolutions=0.25, **at)
    bench.wait(1.0)
    assert bench.axis()["measuring"] == "done"
    dictionary = bench.cabinet.nodes["joint_1"].dictionary
    dictionary[0x2110, 1], dictionary[0x2110, 2] = 200, 512
    rows = np.frombuffer(dictionary.upload(0x2110, 3), TRACE)
    steps = np.diff(rows["enc"])
    (spoilt,) = np.flatnonzero(np.abs(rows["speed"]) > 1000)  # 0.25 rev in 4 ms
    assert spoilt + 200 == 300 if at else recorded <= spoilt + 200 < recorded + 5
    assert np.flatnonzero(np.abs(steps) > 0.1).tolist() == [spoilt - 1, spoilt]
    assert steps[spoilt - 1] == pytest.approx(0.25, abs=0.01)
    assert np.abs(np.diff(rows["enc2"])).max() < 0.001
    assert bench.state() == ("operation_enabled", True)


def test_a_small_glitch_while_streaming(bench: Bench) -> None:
    bench.enable(1, 9)
    bench.frame(0, b"\x01\x01")
    bench.stream(10, 1000)
    bench.order("glitch", revolutions=-0.5)
    seen = bench.stream(10, 1000)
    steps = np.diff([position for _, position in seen]) / 2**20
    assert np.flatnonzero(np.abs(steps) > 0.4).tolist() == [0, 1]
    assert {status & 0x6F for status, _ in seen} == {0x27}


def test_a_large_glitch_is_the_encoder_fault(bench: Bench) -> None:
    bench.enable(1, 1)
    bench.order("glitch", revolutions=1.5, at_sample=100)
    bench.measure(periods=50)
    assert Frame(0x81, struct.pack("<HB5x", 0x7305, 0x21)) in bench.wait(0.5)
    assert bench.state() == ("fault", False)
    assert bench.axis()["measuring"] == "aborted"


def test_a_reboot_forgets_everything_but_the_place(bench: Bench) -> None:
    bench.write(1, 0x6085, 0, "I", 12345)
    bench.write(1, 0x1017, 0, "H", 50)
    bench.enable(1, 1)
    bench.measure(periods=50)
    bench.wait(0.3)
    bench.order("reboot")
    assert bench.take() == [Frame(0x701, b"\0")]
    after = bench.axis()
    assert (after["energised"], after["state"], after["measuring"]) == (False, "switch_on_disabled", "idle")
    assert abs(after["position"]) > 0
    assert (bench.held(0x6085), bench.held(0x1017)) == (5_000_000, 0)
    assert bench.held(0x6064) / 2**20 == pytest.approx(after["position"] * GEAR / (2 * np.pi), abs=1e-5)
