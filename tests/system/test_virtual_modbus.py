"""The virtual machine as a process behind Modbus: a real client over TCP and over a pseudo-terminal, both maps."""

import json
import math
import select
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from pymodbus.exceptions import ModbusIOException

ROOT = Path(__file__).resolve().parents[2]
GEAR = 171.0  # of joint_1
JOINT = "joint_1"
PATIENCE = 30.0  # s for an answer
WORDS = {"high_first": "big", "low_first": "little"}  # as pymodbus calls them


class Host:
    """The process, its control port, and a Modbus client that knows the register map as data only."""

    def __init__(self, ready: dict[str, Any], registers: Path) -> None:
        self.ready = ready
        self.map = yaml.safe_load(registers.read_text())
        self._control = socket.create_connection(("127.0.0.1", ready["control_port"]), timeout=30)
        self._lines = self._control.makefile("rw")
        self.client = self._connect(PATIENCE)

    def close(self) -> None:
        self.client.close()
        self._lines.close()
        self._control.close()

    def reconnect(self, patience: float) -> None:
        """`patience` in s for each answer from now on."""
        self.client.close()
        self.client = self._connect(patience)

    def _connect(self, patience: float) -> ModbusTcpClient | ModbusSerialClient:
        client: ModbusTcpClient | ModbusSerialClient
        if "device" in self.ready:
            client = ModbusSerialClient(self.ready["device"], baudrate=115200, timeout=patience, retries=0)
        else:
            client = ModbusTcpClient("127.0.0.1", port=self.ready["port"], timeout=patience, retries=0)
        assert client.connect()
        return client

    def order(self, name: str, **fields: object) -> dict[str, Any]:
        self._lines.write(json.dumps({"order": name, **fields}) + "\n")
        self._lines.flush()
        return json.loads(self._lines.readline())

    @property
    def truth(self) -> dict[str, Any]:
        return self.order("status")["axes"][JOINT]

    def signal(self, name: str) -> dict[str, Any]:
        return self.map["signals"][name]

    def get(self, name: str, unit: int = 1) -> float:
        signal = self.signal(name)
        return self.registers(signal["address"], 1 if signal["type"].endswith("16") else 2, unit, signal)

    def registers(self, address: int, count: int, unit: int, wire: dict[str, Any]) -> float:
        answer = self.client.read_holding_registers(address, count=count, device_id=unit)
        assert not answer.isError(), answer
        return self.value(list(answer.registers), wire)

    def value(self, registers: list[int], wire: dict[str, Any]) -> float:
        raw = self.client.convert_from_registers(registers, self._type(wire), WORDS[self.map["word_order"]])  # type: ignore[arg-type]
        return float(raw) * wire.get("scale", 1.0)  # type: ignore[arg-type]

    def put(self, name: str, *values: float) -> int:
        """Write; the exception code, 0 for none."""
        signal = self.signal(name)
        registers: list[int] = []
        for value in values:
            raw = value / signal.get("scale", 1.0)
            number = raw if signal["type"] == "f32" else round(raw)
            registers += self.client.convert_to_registers(number, self._type(signal), WORDS[self.map["word_order"]])  # type: ignore[arg-type]
        answer = self.client.write_registers(signal["address"], registers, device_id=1)
        return answer.exception_code if answer.isError() else 0

    def set(self, **values: float) -> None:
        for name, value in values.items():
            assert self.put(name, value) == 0, name

    def enable(self) -> None:
        self.set(mode=1)
        for controlword, expected in ((0x06, 0x21), (0x07, 0x23), (0x0F, 0x27)):
            self.set(controlword=controlword)
            assert int(self.get("statusword")) & 0x6F == expected

    def trace(self) -> np.ndarray[Any, Any]:
        """Every sample recorded, page by page: (n, fields) in the order of the map."""
        trace = self.map["trace"]
        widths = [1 if field["type"].endswith("16") else 2 for field in trace["sample"]]
        capacity = trace["page"]["registers"] // sum(widths)
        samples: list[list[float]] = []
        recorded = int(self.get("samples_recorded"))
        for first in range(0, recorded, capacity):
            count = min(capacity, recorded - first)
            self.set(page_first=first, page_count=count)
            words: list[int] = []
            while len(words) < count * sum(widths):
                size = min(self.map["max_read"], count * sum(widths) - len(words))
                answer = self.client.read_holding_registers(trace["page"]["address"] + len(words), count=size)
                words += answer.registers
            for k in range(count):
                start, row = k * sum(widths), []
                for field, width in zip(trace["sample"], widths, strict=True):
                    row.append(self.value(words[start : start + width], field))
                    start += width
                samples.append(row)
        return np.array(samples)

    def _type(self, wire: dict[str, Any]) -> Any:
        names = {"u16": "UINT16", "i16": "INT16", "u32": "UINT32", "i32": "INT32", "f32": "FLOAT32"}
        return self.client.DATATYPE[names[wire["type"]]]


@pytest.fixture(scope="module", params=[("modbus-tcp", "high"), ("modbus-rtu", "low")], ids="-".join)
def machine(request: pytest.FixtureRequest) -> Iterator[Host]:
    fieldbus, order = request.param
    registers = ROOT / f"config/registers/virtual-{order}-first.yaml"
    command = [sys.executable, "-c", "from service.cli import main; main()", "drive", "--fieldbus", fieldbus]
    command += ["--registers", str(registers), "--port", "0", "--control-port", "0", "--speed-factor", "20"]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        assert process.stdout is not None
        host = Host(json.loads(process.stdout.readline()), registers)
        try:
            assert host.ready["fieldbus"] == fieldbus
            yield host
        finally:
            host.close()
            process.terminate()
            assert process.wait(30) == 0


@pytest.fixture
def host(machine: Host) -> Host:
    """Everything as at power-on, but for where the axes stand."""
    assert machine.order("silence", joint=JOINT, on=False)["ok"]
    assert machine.order("reboot", joint=JOINT)["ok"]
    return machine


def until(condition: Callable[[], object], seconds: float = 60.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "did not happen in time"
        time.sleep(0.005)


def sweep(host: Host, periods: int, offset: float = 1.0) -> list[tuple[float, float, float]]:
    """Start one from standstill, `offset` in rev/min; its sines in Hz, rev/min, rad."""
    sines = [(2.0, 5.0, 0.3), (5.0, 4.0, 1.2)]
    host.set(offset_speed=offset, ramp=0.25, settle=0.5, period=1.0, periods=periods, sines=2, trace_cycle=4)
    for name, column in zip(("frequency", "amplitude", "phase"), zip(*sines, strict=True), strict=True):
        assert host.put(name, *column) == 0
    host.set(measuring_command=1)
    return sines


def test_identification_and_constant(host: Host) -> None:
    assert host.get("constant") == host.signal("constant")["value"]
    identity = {0: b"00005357", 1: b"00000402", 2: b"00010000"}
    for unit in (1, 6):
        serial = 1000 + unit
        assert host.get("serial", unit) == serial
        answer: Any = host.client.read_device_information(read_code=3, device_id=unit)
        assert answer.information == identity | {0x80: f"{serial:08X}".encode()}
    assert (host.get("vendor"), host.get("product"), host.get("revision")) == (0x5357, 0x0402, 0x10000)
    assert host.get("rated_torque") == pytest.approx(17.544)


def test_a_sweep_and_its_trace(host: Host) -> None:
    host.enable()
    offset = 0.1 * GEAR
    sines = sweep(host, 2, offset)
    assert host.get("measuring_state") in (1, 2)  # 150 ms at 20 times real time: on a busy computer it is over by now
    until(lambda: host.get("measuring_state") == 2)
    truth = host.truth
    assert (truth["measuring"], truth["samples"]) == ("done", 750)
    trace = host.trace()
    column = {field["signal"]: trace[:, k] for k, field in enumerate(host.map["trace"]["sample"])}
    assert np.array_equal(column["cycle"], np.arange(750))
    assert column["position"][-1] / GEAR * math.tau == pytest.approx(truth["position"], abs=2e-4)
    assert column["load_position"][-1] * math.tau == pytest.approx(truth["position"], abs=5e-3)
    assert np.ptp(column["load_position"]) * GEAR == pytest.approx(np.ptp(column["position"]), rel=0.02)
    time_in = (np.arange(750) * 4 + 2) * 1e-3  # the middle of each trace cycle
    expected = np.full(750, offset)
    for frequency, amplitude, phase in sines:
        expected += amplitude * np.sin(2 * np.pi * frequency * (time_in - 0.75) + phase)
    window = slice(187, 687)  # about the two periods
    assert column["set_speed"][window] == pytest.approx(expected[window], abs=0.05)
    speed, set_speed = (np.fft.rfft(column[name][window])[[4, 10]] for name in ("speed", "set_speed"))
    assert abs(speed / set_speed) == pytest.approx([1.0, 1.0], abs=0.3)
    assert column["torque"].std() > 0.01
    assert host.client.read_holding_registers(host.map["trace"]["page"]["address"], count=2).registers != [0, 0]
    host.set(page_first=750)
    assert host.client.read_holding_registers(host.map["trace"]["page"]["address"], count=2).registers == [0, 0]


def test_hostile_bytes_leave_the_machine_alone(host: Host) -> None:
    host.enable()
    cut, unknown = b"\0\1\0\0\0\6\1\x2b\x0e\1\0", b"\0\1\0\0\0\2\1\x64"
    for data in (b"\0" * 300, b"\xff" * 64, cut, unknown, b"GET / HTTP/1.1\r\n\r\n"):
        if "device" in host.ready:
            host.client.send(data)
        else:
            with socket.create_connection(("127.0.0.1", host.ready["port"]), timeout=5) as client:
                client.sendall(data)
                select.select([client], [], [], 0.05)
    host.reconnect(1.0)
    until(lambda: answers(host))  # a serial line may lose a request to the rest of the noise before it
    host.reconnect(PATIENCE)
    assert int(host.get("statusword")) & 0x6F == 0x27
    assert host.truth["state"] == "operation_enabled"


def answers(host: Host) -> bool:
    try:
        return host.get("serial") == 1001
    except ModbusIOException:
        return False
