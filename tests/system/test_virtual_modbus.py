"""The virtual machine as a process behind Modbus: a real client over TCP and over a pseudo-terminal, both maps."""

import json
import select
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from pymodbus.exceptions import ModbusIOException

ROOT = Path(__file__).resolve().parents[2]
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
        count = 1 if signal["type"].endswith("16") else 2
        answer = self.client.read_holding_registers(signal["address"], count=count, device_id=unit)
        assert not answer.isError(), answer
        raw = self.client.convert_from_registers(answer.registers, self._type(signal), WORDS[self.map["word_order"]])  # type: ignore[arg-type]
        return float(raw) * signal.get("scale", 1.0)  # type: ignore[arg-type]

    def put(self, name: str, value: int) -> None:
        signal = self.signal(name)
        words = self.client.convert_to_registers(value, self._type(signal), WORDS[self.map["word_order"]])  # type: ignore[arg-type]
        assert not self.client.write_registers(signal["address"], words, device_id=1).isError(), name

    def enable(self) -> None:
        self.put("mode", 1)
        for controlword, expected in ((0x06, 0x21), (0x07, 0x23), (0x0F, 0x27)):
            self.put("controlword", controlword)
            assert int(self.get("statusword")) & 0x6F == expected

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
