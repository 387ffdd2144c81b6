"""The virtual machine as a process: real CAN frames on loopback, with nothing of this project in between."""

import json
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can
import canopen
import numpy as np
import pytest
from canopen.sdo.client import SdoClient
from canopen.sdo.exceptions import SdoAbortedError

ROOT = Path(__file__).resolve().parents[2]
EDS = str(ROOT / "config/eds/virtual-axis.eds")
GEAR = 171.0  # of joint_1
HOST = 127
PATIENCE = 60.0  # s for an answer
TRACE = np.dtype(
    [("cycle", "<u4"), ("torque", "<f4"), ("command", "<f4"), ("speed", "<f4"), ("enc", "<f8"), ("enc2", "<f8")]
)


class Machine:
    """The process, its control port, and a bus to it."""

    def __init__(self, process: subprocess.Popen[str], ready: dict[str, Any]) -> None:
        self.process = process
        self.port: int = ready["port"]
        self._control = socket.create_connection(("127.0.0.1", ready["control_port"]), timeout=60)
        self._lines = self._control.makefile("rw")

    def order(self, name: str, **fields: object) -> dict[str, Any]:
        self._lines.write(json.dumps({"order": name, **fields}) + "\n")
        self._lines.flush()
        return json.loads(self._lines.readline())

    def axis(self, joint: str = "joint_1") -> dict[str, Any]:
        return self.order("status")["axes"][joint]

    def bus(self) -> can.BusABC:
        return can.Bus(interface="socketcand", host="127.0.0.1", port=self.port, channel="can0", tcp_tune=True)

    def close(self) -> None:
        self._lines.close()
        self._control.close()


@pytest.fixture
def machine() -> Iterator[Machine]:
    command = [sys.executable, "-c", "from service.cli import main; main()", "drive"]
    command += ["--port", "0", "--control-port", "0", "--speed-factor", "20", "--seed", "1"]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        assert process.stdout is not None
        machine = Machine(process, json.loads(process.stdout.readline()))
        try:
            yield machine
        finally:
            machine.close()
            process.terminate()
            assert process.wait(60) == 0


@pytest.fixture
def network(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> Iterator[canopen.Network]:
    monkeypatch.setattr(canopen.Network, "NOTIFIER_CYCLE", 0.02)
    monkeypatch.setattr(SdoClient, "RESPONSE_TIMEOUT", PATIENCE)
    network = canopen.Network(machine.bus())
    network.connect()
    try:
        yield network
    finally:
        network.disconnect()


@pytest.fixture
def node(network: canopen.Network) -> canopen.RemoteNode:
    return network.add_node(1, EDS)


def until(condition: Callable[[], object], seconds: float = 60.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "did not happen in time"
        time.sleep(0.002)


def entry(node: canopen.RemoteNode | canopen.LocalNode, index: int, sub: int | None = None) -> Any:
    """What an object's number leads to; canopen gives a variable, an array or a record by its dictionary."""
    found: Any = node.sdo[index]
    return found if sub is None else found[sub]


def state(node: canopen.RemoteNode) -> int:
    return entry(node, 0x6041).raw & 0x6F


def enable(node: canopen.RemoteNode, mode: int) -> None:
    entry(node, 0x6060).raw = mode
    for controlword, expected in ((0x06, 0x21), (0x07, 0x23), (0x0F, 0x27)):
        entry(node, 0x6040).raw = controlword
        assert state(node) == expected


def start_sweep(node: canopen.RemoteNode, periods: int = 2) -> None:
    parameters = {4: 0.1 * GEAR, 5: 0.25, 6: 0.5, 7: 1.0, 8: periods, 9: 2, 0x0A: 4}
    for sub, value in parameters.items():
        entry(node, 0x2100, sub).raw = value
    for sub, (frequency, amplitude) in enumerate(((2.0, 5.0), (5.0, 5.0)), 1):
        entry(node, 0x2101, sub).raw, entry(node, 0x2102, sub).raw = frequency, amplitude
    entry(node, 0x2100, 1).raw = 1


def measuring(node: canopen.RemoteNode) -> int:
    return entry(node, 0x2100, 2).raw


def test_says_who_it_is_and_keeps_its_ranges(machine: Machine, network: canopen.Network) -> None:
    identities = []
    for number in range(1, 7):
        node = network.add_node(number, EDS)
        identities.append([entry(node, 0x1018, sub).raw for sub in (1, 2, 3, 4)])
    assert identities == [[0x5357, 0x402, 0x10000, 1000 + number] for number in range(1, 7)]
    node = network[1]
    assert entry(node, 0x1008).raw == "sweepid virtual axis"
    assert entry(node, 0x6076).raw == round(1000 * 3000 / GEAR)
    for index, value, code in ((0x605A, 7, 0x06090031), (0x605D, 0, 0x06090032), (0x6041, 0, 0x06010002)):
        with pytest.raises(SdoAbortedError) as refused:
            entry(node, index).raw = value
        assert refused.value.code == code
    assert not any(axis["energised"] for axis in machine.order("status")["axes"].values())


def test_moves_to_a_position_and_stands_without_torque(machine: Machine, node: canopen.RemoteNode) -> None:
    enable(node, mode=1)
    target = 0.2 * GEAR / (2 * np.pi)
    entry(node, 0x607A).raw = round(target * 2**20)
    entry(node, 0x6081).raw = round(0.3 * GEAR / (2 * np.pi) * 60_000)
    entry(node, 0x6040).raw = 0x1F
    until(lambda: entry(node, 0x6041).raw & 0x1400 == 0x1400)
    assert machine.axis()["position"] == pytest.approx(0.2, abs=1e-4)
    assert entry(node, 0x6064).raw == pytest.approx(target * 2**20, abs=2000)
    entry(node, 0x6040).raw = 0
    assert state(node) == 0x40
    rest = machine.axis()
    assert not rest["energised"]
    time_before = machine.order("status")["plant_time"]
    assert machine.order("status")["plant_time"] == time_before


def test_streams_velocity_by_sync(machine: Machine, node: canopen.RemoteNode) -> None:
    entry(node, 0x2121, 1).raw = 3000  # ms without SYNC: a busy computer is no fault here
    enable(node, mode=9)
    bus = machine.bus()
    try:
        bus.send(can.Message(arbitration_id=0, data=[1, 1], is_extended_id=False))
        until(lambda: machine.axis()["nmt"] == "operational")
        speed = round(0.05 * GEAR / (2 * np.pi) * 60_000)
        counters, positions, speeds = [], [], []
        cycles = 150
        for cycle in range(cycles):
            wanted = round(speed * min(1.0, cycle / 50))
            bus.send(can.Message(arbitration_id=0x201, data=struct.pack("<Hi", 0x0F, wanted), is_extended_id=False))
            bus.send(can.Message(arbitration_id=0x80, is_extended_id=False))
            frames: dict[int, bytes] = {}
            while len(frames) < 2:
                message = bus.recv(PATIENCE)
                assert message is not None
                if message.arbitration_id in (0x181, 0x281):
                    frames[message.arbitration_id] = bytes(message.data)
            status, actual, _ = struct.unpack("<Hih", frames[0x181])
            position, counter = struct.unpack("<iI", frames[0x281])
            assert status & 0x6F == 0x27
            counters.append(counter)
            positions.append(position)
            speeds.append(actual)
        assert np.all(np.diff(counters) == 1)
        assert np.mean(speeds[-50:]) == pytest.approx(speed, rel=0.05)
        travelled = (positions[-1] - positions[-51]) / 2**20
        assert travelled == pytest.approx(50 * 0.004 * speed / 60_000, rel=0.05)
        assert machine.order("status")["plant_time"] >= cycles * 0.004 - 0.004
        # No more SYNC: the drive notices, brakes and closes the brake.
        until(lambda: machine.axis()["state"] == "fault")
        assert machine.axis()["fault"] == 0x8700
        assert not machine.axis()["energised"]
    finally:
        bus.shutdown()


def test_measures_a_sweep_and_gives_its_trace(machine: Machine, node: canopen.RemoteNode) -> None:
    enable(node, mode=1)
    start_sweep(node)
    until(lambda: measuring(node) != 1)
    assert measuring(node) == 2
    assert entry(node, 0x2100, 0x0B).raw == 750  # 3 s at 4 ms
    data = b""
    for first in (0, 512):
        entry(node, 0x2110, 1).raw, entry(node, 0x2110, 2).raw = first, 512
        with entry(node, 0x2110, 3).open("rb", block_transfer=True, buffering=0) as page:
            block = page.read()
        assert block == node.sdo.upload(0x2110, 3)
        data += block
    trace = np.frombuffer(data, TRACE)
    assert np.array_equal(trace["cycle"], np.arange(750))
    window = slice(187, 687)  # about the two periods
    response = np.fft.rfft(trace["speed"][window])
    command = np.fft.rfft(trace["command"][window])
    assert abs(command[[4, 10]]) == pytest.approx([5 * 250] * 2, rel=0.02)
    assert abs(response[[4, 10]] / command[[4, 10]]) == pytest.approx([1.0, 1.0], abs=0.3)
    assert trace["enc"][-1] / GEAR == pytest.approx(trace["enc2"][-1], abs=1e-3)
    assert state(node) == 0x27


def test_refuses_a_sweep_it_must_not_run(node: canopen.RemoteNode) -> None:
    start_sweep(node)
    assert (measuring(node), entry(node, 0x2100, 3).raw) == (4, 1)
    enable(node, mode=1)
    entry(node, 0x6080).raw = 1000
    start_sweep(node)
    assert (measuring(node), entry(node, 0x2100, 3).raw) == (4, 2)
    assert entry(node, 0x606C).raw == pytest.approx(0, abs=500)


def test_a_lost_host_stops_a_moving_axis(machine: Machine, node: canopen.RemoteNode) -> None:
    host = machine.bus()
    try:
        entry(node, 0x1016, 1).raw = HOST << 16 | 4000  # ms, for all that is said before the sweep begins
        host.send(can.Message(arbitration_id=0x700 + HOST, data=[5], is_extended_id=False))
        enable(node, mode=1)
        start_sweep(node, periods=200)  # 10 s: far longer than the heartbeat
        until(lambda: machine.axis()["samples"] > 100)
        until(lambda: machine.axis()["state"] == "fault")
        stopped = machine.axis()
        assert stopped["fault"] == 0x8130
        assert not stopped["energised"]
        assert stopped["measuring"] == "aborted"
        assert stopped["samples"] > 100
        assert [entry.code for entry in node.emcy.log] == [0x8130]
        entry(node, 0x6040).raw = 0
        entry(node, 0x6040).raw = 0x80
        assert state(node) == 0x40
    finally:
        host.shutdown()


def test_faults_to_order(machine: Machine, node: canopen.RemoteNode) -> None:
    enable(node, mode=1)
    assert machine.order("fault", joint="joint_1", code=0x7305, at_sample=200)["ok"]
    start_sweep(node, periods=5)
    until(lambda: state(node) == 0x08)
    assert measuring(node) == 3
    assert 200 <= entry(node, 0x2100, 0x0B).raw < 240
    assert entry(node, 0x603F).raw == 0x7305
    assert not machine.axis()["energised"]

    assert machine.order("emergency_stop", on=True)["ok"]
    entry(node, 0x6040).raw = 0x80
    assert state(node) == 0x08
    assert machine.order("emergency_stop", on=False)["ok"]
    entry(node, 0x6040).raw = 0
    entry(node, 0x6040).raw = 0x80
    assert state(node) == 0x40

    assert machine.order("silence", joint="joint_1", on=True)["ok"]
    node.sdo.RESPONSE_TIMEOUT = 0.1
    with pytest.raises(canopen.SdoCommunicationError):
        node.sdo.upload(0x6041, 0)
    assert machine.order("silence", joint="joint_1", on=False)["ok"]
    node.sdo.RESPONSE_TIMEOUT = PATIENCE
    assert machine.order("identity", joint="joint_1", product=7)["ok"]
    assert entry(node, 0x1018, 2).raw == 7

    assert machine.order("fault", joint="nothing", code=1) == {
        "ok": False,
        "error": "joint 'nothing' is not one of joint_1, joint_2, joint_3, joint_4, joint_5, joint_6",
    }
    assert not machine.order("explode")["ok"]


def test_lost_and_frozen_counters(machine: Machine) -> None:
    bus = machine.bus()

    def receive() -> can.Message:
        message = bus.recv(PATIENCE)
        assert message is not None
        return message

    def counters(syncs: int) -> list[int]:
        for _ in range(syncs):
            bus.send(can.Message(arbitration_id=0x80, is_extended_id=False))
        read = struct.pack("<BHB4x", 0x40, 0x6041, 0)  # answered after everything that the SYNCs caused
        bus.send(can.Message(arbitration_id=0x601, data=read, is_extended_id=False))
        found: list[int] = []
        while (message := receive()).arbitration_id != 0x581:
            if message.arbitration_id == 0x281:
                found.append(struct.unpack_from("<I", message.data, 4)[0])
        return found

    try:
        bus.send(can.Message(arbitration_id=0, data=[1, 1], is_extended_id=False))
        assert counters(3) == [1, 2, 3]
        assert machine.order("drop_tpdos", joint="joint_1", count=4)["ok"]  # two TPDOs a SYNC
        assert counters(3) == [6]
        assert machine.order("freeze_counter", joint="joint_1", on=True)["ok"]
        assert counters(2) == [6, 6]
    finally:
        bus.shutdown()


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--scenario", "nowhere.yaml"], "nowhere.yaml: cannot be read"),
        (["--eds", "{bad}"], "{bad}: not an EDS"),
    ],
)
def test_bad_arguments_end_with_one_line(arguments: list[str], reason: str, tmp_path: Path) -> None:
    bad = tmp_path / "bad.eds"
    bad.write_text("this is none")
    command = [sys.executable, "-c", "from service.cli import main; main()", "drive"]
    command += [argument.format(bad=bad) for argument in arguments]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 2
    assert done.stderr.strip().startswith(reason.format(bad=bad))
    assert len(done.stderr.strip().splitlines()) == 1
    assert done.stdout == ""
