"""Nodes and machine on one clock: frames and times in, frames out. The machine is the real (rigid) one."""

import struct
from collections.abc import Callable
from pathlib import Path

import pytest

from simulator import Scenario
from simulator.canopen.cabinet import Cabinet
from simulator.canopen.node import Frame
from simulator.machine import Machine

EDS = Path(__file__).parents[4] / "config/eds/virtual-axis.eds"


class Bench:
    """A cabinet with a clock in the test's hand."""

    def __init__(self, machine: Machine, speed_factor: float) -> None:
        self.sent: list[Frame] = []
        self.now = 1000.0
        self.machine = machine
        self.cabinet = Cabinet(machine, EDS, speed_factor, self.sent.append)
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

    def axis(self, joint: str) -> dict[str, object]:
        return self.cabinet.status()["axes"][joint]  # type: ignore[index]


@pytest.fixture
def bench(scenario: Callable[[str], Scenario]) -> Bench:
    return Bench(Machine(scenario("rigid"), 1), speed_factor=5.0)


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
    assert bench.axis("joint_1")["state"] == "fault"
    assert not bench.axis("joint_1")["energised"]
    assert bench.cabinet.due(bench.now) == float("inf")


def test_moves_run_faster_than_real_time_and_standing_does_not(bench: Bench) -> None:
    bench.enable(2, 1)
    bench.wait(0.2)
    assert bench.cabinet.status()["plant_time"] == pytest.approx(0.2, abs=0.03)
    bench.write(2, 0x607A, 0, "i", 10 << 20)
    bench.write(2, 0x6040, 0, "H", 0x1F)
    bench.wait(0.1)
    assert bench.cabinet.status()["plant_time"] == pytest.approx(0.7, abs=0.03)


def test_leaving_operational_is_a_quick_stop(bench: Bench) -> None:
    bench.frame(0, b"\x01\x02")
    bench.enable(2, 1)
    bench.write(2, 0x607A, 0, "i", 20 << 20)
    bench.write(2, 0x6040, 0, "H", 0x1F)
    bench.wait(0.1)
    assert float(str(bench.axis("joint_2")["velocity"])) > 0.01
    bench.frame(0, b"\x80\x02")
    bench.wait(0.3)
    assert bench.axis("joint_2")["state"] == "switch_on_disabled"
    assert not bench.axis("joint_2")["energised"]
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


def test_the_drive_is_described_by_robot_and_scenario(bench: Bench) -> None:
    info, dictionary = bench.machine.axes[1], bench.cabinet.nodes["joint_2"].dictionary
    assert dictionary[0x6076, 0] == round(info.rated_effort / info.gear_ratio * 1000)
    assert dictionary[0x6072, 0] == 2000
    assert dictionary[0x607D, 1] < 0 < dictionary[0x607D, 2]
