"""A virtual machine in this process on a real CAN, socketcand on loopback or python-can's virtual bus, and its host."""

import json
import os
import socket
import struct
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import can

from simulator.machine import Machine
from simulator.scenario import load_scenario
from simulator.virtual_drive import VirtualDrive

CONFIG = Path(__file__).resolve().parents[2] / "config"
GEAR = 171.0  # of joint_1


def until(condition: Callable[[], object], seconds: float = 60.0) -> None:
    """Looks rarely for what takes long: the machine runs in this process, and looking takes its time."""
    began = time.monotonic()
    while not condition():
        waited = time.monotonic() - began
        assert waited < seconds, "did not happen in time"
        time.sleep(min(max(waited / 50, 0.002), 0.02))


class Host:
    """One client of the bus: SDO by hand, SYNC, and every frame that came, by identifier."""

    def __init__(self, bus: can.BusABC) -> None:
        self.bus = bus
        self.frames: list[can.Message] = []

    def send(self, identifier: int, data: bytes = b"") -> None:
        self.bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))

    def receive(self, seconds: float) -> can.Message | None:
        message = self.bus.recv(seconds)
        if message is not None:
            self.frames.append(message)
        return message

    def of(self, identifier: int) -> list[bytes]:
        """The data of the frames with an identifier, in the order they came."""
        return [bytes(f.data) for f in self.frames if f.arbitration_id == identifier and not f.is_error_frame]

    def wait_for(self, identifier: int, seconds: float = 60.0, *, error: bool = False) -> bytes:
        """The data of the next such frame."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            message = self.receive(0.1)
            if message is not None and message.arbitration_id == identifier and message.is_error_frame is error:
                return bytes(message.data)
        raise AssertionError(f"no frame {identifier:x}")

    def request(self, node: int, data: bytes) -> bytes:
        self.send(0x600 + node, data)
        return self.wait_for(0x580 + node)

    def write(self, node: int, index: int, sub: int, layout: str, value: float) -> int:
        """Abort code, or 0; expedited, a REAL64 segmented."""
        data = struct.pack("<" + layout, value)
        head = struct.pack("<BHB", 0x23 | (4 - len(data)) << 2 if len(data) <= 4 else 0x21, index, sub)
        answer = self.request(node, head + (data if len(data) <= 4 else struct.pack("<I", len(data))).ljust(4, b"\0"))
        if len(data) > 4 and answer[0] == 0x60:
            self.request(node, b"\x00" + data[:7])
            answer = self.request(node, b"\x1d" + data[7:].ljust(7, b"\0"))
        return struct.unpack_from("<I", answer, 4)[0] if answer[0] == 0x80 else 0

    def read(self, node: int, index: int, sub: int, layout: str) -> int:
        answer = self.request(node, struct.pack("<BHB4x", 0x40, index, sub))
        assert answer[0] != 0x80, f"{index:x}h:{sub} {answer.hex()}"
        return struct.unpack_from("<" + layout, answer, 4)[0]

    def enable(self, node: int, mode: int) -> None:
        assert self.write(node, 0x6060, 0, "b", mode) == 0
        for controlword, state in ((0x06, 0x21), (0x07, 0x23), (0x0F, 0x27)):
            assert self.write(node, 0x6040, 0, "H", controlword) == 0
            assert self.read(node, 0x6041, 0, "H") & 0x6F == state

    def move(self, node: int, revolutions: float) -> None:
        self.write(node, 0x607A, 0, "i", round(revolutions * 2**20))
        self.write(node, 0x6040, 0, "H", 0x0F)
        self.write(node, 0x6040, 0, "H", 0x1F)

    def reset_fault(self, node: int) -> int:
        """The state after a rising edge of bit 7."""
        self.write(node, 0x6040, 0, "H", 0)
        self.write(node, 0x6040, 0, "H", 0x80)
        return self.read(node, 0x6041, 0, "H") & 0x6F

    def start_sweep(self, node: int, periods: int = 2) -> None:
        """0.1 rad/s^-1 of joint_1, two sines; 3 s with two periods, 4 ms a sample."""
        for sub, value in {4: 0.1 * GEAR, 5: 0.25, 6: 0.5, 7: 1.0}.items():
            assert self.write(node, 0x2100, sub, "d", value) == 0
        for sub, value in {8: periods, 9: 2, 0x0A: 4}.items():
            assert self.write(node, 0x2100, sub, "H", value) == 0
        for sub, frequency in enumerate((2.0, 5.0), 1):
            self.write(node, 0x2101, sub, "d", frequency)
            self.write(node, 0x2102, sub, "d", 5.0)
        assert self.write(node, 0x2100, 1, "H", 1) == 0


class Bench:
    """The running machine: hosts of its bus, and its control port."""

    def __init__(self, drive: VirtualDrive, interface: str, channel: str) -> None:
        self._drive, self._interface, self._channel = drive, interface, channel
        self.hosts: list[Host] = []
        self._control = socket.create_connection(("127.0.0.1", drive.control_port), timeout=60)
        self._lines = self._control.makefile("rw")

    def order(self, name: str, **fields: object) -> dict[str, Any]:
        self._lines.write(json.dumps({"order": name, **fields}) + "\n")
        self._lines.flush()
        return json.loads(self._lines.readline())

    def do(self, name: str, **fields: object) -> None:
        assert self.order(name, **fields) == {"ok": True}

    def axis(self, joint: str = "joint_1") -> dict[str, Any]:
        return self.order("status")["axes"][joint]

    def host(self) -> Host:
        if self._interface == "socketcand":
            bus = can.Bus(
                interface="socketcand", host="127.0.0.1", port=self._drive.port, channel="can0", tcp_tune=True
            )
        else:
            bus = can.Bus(interface=self._interface, channel=self._channel)
        self.hosts.append(Host(bus))
        return self.hosts[-1]

    def close(self) -> None:
        for host in self.hosts:
            host.bus.shutdown()
        self._lines.close()
        self._control.close()


@contextmanager
def bench(
    interface: str = "socketcand", *, eds: str = "virtual-axis", scenario: str = "max100-full", factor: float = 20.0
) -> Iterator[Bench]:
    """A machine that runs while the block does."""
    channel = "can0" if interface == "socketcand" else f"faults-{os.getpid()}-{uuid.uuid4()}"
    machine = Machine(load_scenario(CONFIG / "scenarios" / f"{scenario}.yaml"), 1)
    drive = VirtualDrive(machine, CONFIG / "eds" / f"{eds}.eds", bus=interface, channel=channel, speed_factor=factor)
    thread = threading.Thread(target=drive.run, name="virtual-drive")
    thread.start()
    running = Bench(drive, interface, channel)
    try:
        yield running
    finally:
        running.close()
        drive.stop()
        thread.join(60)
        drive.close()
        assert not thread.is_alive()
