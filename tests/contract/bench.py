"""A real virtual machine on a real bus for every adapter; the suite itself knows only `DrivePort` and this bench."""

import asyncio
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import AsyncGenerator, Callable, Iterator, Mapping
from contextlib import AbstractContextManager, asynccontextmanager, contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from drivers.ports import DrivePort, NoiseCommand, SampleBlock, Sine, SweepCommand, SweepMode
from drivers.registry import load_profile, open_drive
from simulator.machine import Machine
from simulator.scenario import load_scenario
from simulator.virtual_drive import VirtualDrive
from tests.contract import makers
from tests.foreign_bench import bench as foreign_bench

ROOT = Path(__file__).parents[2]
DRIVES = ROOT / "config" / "drives"
SCENARIO = ROOT / "config" / "scenarios" / "max100-full.yaml"
EDS = ROOT / "config" / "eds" / "virtual-axis.eds"
REGISTERS = ROOT / "config" / "registers"
SPEED_FACTOR = 20.0
SYNC_PERIOD = 0.008  # s: twice that of the machine in config, for a busy computer has to keep up with it

AXIS, OTHER = "joint_1", "joint_3"


@dataclass(frozen=True)
class Virtual:
    """A running virtual machine: its profile, and its control port for faults to order and for the truth.

    `process` is its process where it has one of its own.
    """

    bench: "Bench"
    profile: Mapping[str, object]
    control_port: int
    process: subprocess.Popen[bytes] | None = None

    def order(self, order: str, **fields: object) -> dict[str, Any]:
        with socket.create_connection(("127.0.0.1", self.control_port), timeout=10) as client:
            client.sendall(json.dumps({"order": order, **fields}).encode() + b"\n")
            reply = cast("dict[str, Any]", json.loads(client.makefile().readline()))
        assert reply["ok"], reply
        return reply

    def truth(self, joint: str = AXIS) -> dict[str, Any]:
        return self.order("status")["axes"][joint]

    def energised(self) -> list[str]:
        return [joint for joint, axis in self.order("status")["axes"].items() if axis["energised"]]

    def recover(self) -> None:
        """Take back every disturbance that lasts; faults stay until they are acknowledged."""
        for joint, (order, nothing) in product((AXIS, OTHER), LASTING.items()):
            if order in self.bench.orders:
                self.order(order, joint=joint, **nothing)
        if "bus_off" in self.bench.orders:
            self.order("bus_on")
        self.order("emergency_stop", on=False)

    def open(self) -> DrivePort:
        return open_drive(self.profile, DRIVES)


@dataclass(frozen=True)
class Bench:
    """An adapter on a bus, and what there is to test with it."""

    adapter: str
    modes: frozenset[SweepMode]
    orders: frozenset[str]  # of the control port, as far as this fieldbus can have the fault
    machine: Callable[["Bench"], AbstractContextManager[Virtual]]
    injects: bool = False  # torque noise
    own_process: bool = True  # which can die
    exclusive: bool = False  # one host at a time
    vcan: bool = False  # needs a kernel with CAN: runs with --vcan, and then no other does
    alike: bool = False  # differs from another bench in bus or dictionary alone: runs with --every-drive


def rate(mode: SweepMode) -> float:
    """Samples a second of a sweep."""
    return 1 / SYNC_PERIOD if mode is SweepMode.HOST_STREAMED else 250.0


def _profile(name: str, section: str, **changes: object) -> dict[str, object]:
    profile = load_profile(DRIVES / f"{name}.yaml")
    pace = {"sync_period": SYNC_PERIOD} if section == "bus" else {}
    profile[section] = {**cast("dict[str, object]", profile[section]), **pace, **changes}
    return profile


@contextmanager
def _process(bench: Bench, *options: str, profile: Callable[[Any], dict[str, object]]) -> Iterator[Virtual]:
    """`sweepid drive` in a process of its own; `profile` leads to what its ready line tells."""
    command = [str(Path(sys.executable).with_name("sweepid")), "drive", "--scenario", str(SCENARIO)]
    command += ["--speed-factor", str(SPEED_FACTOR), *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, cwd=ROOT) as process:
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            assert line, f"{' '.join(command)} ended before it was ready"
            ready = json.loads(line)
            yield Virtual(bench, profile(ready), ready["control_port"], process)
        finally:
            process.terminate()
    assert process.returncode in (0, -signal.SIGKILL)


def _over_socketcand(bench: Bench) -> AbstractContextManager[Virtual]:
    options = ("--eds", str(EDS), "--port", "0")
    return _process(bench, *options, profile=lambda ready: _profile("virtual-max100", "bus", port=ready["port"]))


def _over_vcan(bench: Bench) -> AbstractContextManager[Virtual]:
    options = ("--eds", str(EDS), "--bus", "socketcan", "--channel", "vcan0")
    bus = {"interface": "socketcan", "channel": "vcan0", "host": None, "port": None}
    patience = {"drive_timeout": 3.0}  # s; the guest's one slow CPU
    return _process(bench, *options, profile=lambda _: _profile("virtual-max100", "bus", **bus, **patience))


@contextmanager
def in_one_process(bench: Bench, eds: Path = EDS) -> Iterator[Virtual]:
    """On python-can's virtual bus, drives with the dictionary `eds`."""
    channel = f"contract-{os.getpid()}-{uuid.uuid4()}"
    virtual = VirtualDrive(
        Machine(load_scenario(SCENARIO), 0), eds, bus="virtual", channel=channel, speed_factor=SPEED_FACTOR
    )
    thread = threading.Thread(target=virtual.run, name="virtual-drive")
    thread.start()
    try:
        profile = _profile("virtual-max100", "bus", interface="virtual", channel=channel, host=None, port=None)
        yield Virtual(bench, profile, virtual.control_port)
    finally:
        virtual.stop()
        thread.join()
        virtual.close()


@contextmanager
def _foreign(bench: Bench, dictionary: str, bus: str = "virtual") -> Iterator[Virtual]:
    """Drives of another maker's dictionary; skipped where that is in ../shared and the folder is absent."""
    with foreign_bench(dictionary, bus=bus, scenario=SCENARIO, speed_factor=SPEED_FACTOR) as foreign:
        yield Virtual(bench, makers.profile(dictionary, foreign, DRIVES), foreign.control_port)


def _over_modbus_tcp(bench: Bench) -> AbstractContextManager[Virtual]:
    options = ("--fieldbus", "modbus-tcp", "--registers", str(REGISTERS / "virtual-high-first.yaml"), "--port", "0")
    name = "virtual-max100-modbus-tcp"
    return _process(bench, *options, profile=lambda ready: _profile(name, "line", port=ready["port"]))


def _over_modbus_rtu(bench: Bench) -> AbstractContextManager[Virtual]:
    options = ("--fieldbus", "modbus-rtu", "--registers", str(REGISTERS / "virtual-low-first.yaml"), "--device", "pty")
    name = "virtual-max100-modbus-rtu"
    silence = {"silence_between_frames": 0.002}  # s; the virtual drive needs none
    return _process(bench, *options, profile=lambda ready: _profile(name, "line", device=ready["device"], **silence))


BOTH, DRIVE_SIDE = frozenset(SweepMode), frozenset({SweepMode.DRIVE_SIDE})
STREAMED = BOTH - DRIVE_SIDE
ORDERS = frozenset({"fault", "emergency_stop", "silence", "limit", "glitch", "saturate", "reboot", "swap", "identity"})
FOREIGN_ORDERS = ORDERS | {"emcy", "drop_tpdos", "bus_off"}
CAN_ORDERS = ORDERS | {"emcy", "drop_tpdos", "duplicate_tpdos", "delay_tpdos", "freeze_counter", "bus_off"}
LASTING: dict[str, dict[str, object]] = {  # what takes an order back
    "silence": {"on": False},
    "limit": {"on": False},
    "saturate": {"torque_permille": None},
    "freeze_counter": {"on": False},
    "drop_tpdos": {"count": 0},
    "duplicate_tpdos": {"count": 0},
    "delay_tpdos": {"count": 0, "cycles": 0},
}


def _other_maker(dictionary: str, bus: str = "virtual", *, alike: bool = False) -> Bench:
    machine = partial(_foreign, dictionary=dictionary, bus=bus)
    return Bench("canopen-402", STREAMED, FOREIGN_ORDERS, machine, own_process=False, exclusive=True, alike=alike)


BENCHES: dict[str, Bench] = {
    "canopen-socketcand": Bench("canopen", BOTH, CAN_ORDERS, _over_socketcand, injects=True, exclusive=True),
    "canopen-virtual": Bench(
        "canopen", BOTH, CAN_ORDERS, in_one_process, injects=True, own_process=False, exclusive=True
    ),
    "canopen-vcan": Bench("canopen", BOTH, CAN_ORDERS, _over_vcan, injects=True, exclusive=True, vcan=True),
    "plain-virtual": _other_maker("plain"),
    "plain-socketcand": _other_maker("plain", "socketcand", alike=True),
    "epos4-virtual": _other_maker("epos4"),  # these two read ../shared
    "gold-virtual": _other_maker("gold", alike=True),
    "modbus-tcp": Bench("modbus", DRIVE_SIDE, ORDERS, _over_modbus_tcp),
    "modbus-rtu": Bench("modbus", DRIVE_SIDE, ORDERS, _over_modbus_rtu, exclusive=True),
}


async def sweep(port: DrivePort, mode: SweepMode, periods: int = 2, **changes: object) -> SweepCommand:
    """A short sweep of `AXIS` from where it stands, with a window around that."""
    start = (await port.status())[AXIS].position
    fields: dict[str, object] = {
        "joint": AXIS,
        "mode": mode,
        "offset_velocity": 0.0105,
        "sines": (Sine(2.0, 0.002, 0.3), Sine(4.0, 0.002, 1.1)),
        "period": 0.5,
        "periods": periods,
        "ramp": 0.2,
        "settle": 0.2,
        "sample_rate": rate(mode),
        "velocity_limit": 0.05,
        "effort_limit": 5000.0,
        "position_window": (start - 0.5, start + 0.5),
    }
    return SweepCommand(**(fields | changes))  # pyright: ignore[reportArgumentType]


async def noise(port: DrivePort, periods: int = 4, **changes: object) -> NoiseCommand:
    """A short noise run of `AXIS` from where it stands, 2 % of rated torque from 2 to 40 Hz."""
    start = (await port.status())[AXIS].position
    fields: dict[str, object] = {
        "joint": AXIS,
        "offset_velocity": 0.0105,
        "effort": 60.0,
        "lowest": 2.0,
        "highest": 40.0,
        "period": 0.5,
        "periods": periods,
        "seed": 7,
        "softening": 0.5,
        "ramp": 0.2,
        "settle": 0.2,
        "sample_rate": 250.0,
        "velocity_limit": 0.1,
        "effort_limit": 5000.0,
        "position_window": (start - 0.5, start + 0.5),
    }
    return NoiseCommand(**(fields | changes))  # pyright: ignore[reportArgumentType]


async def consume(
    port: DrivePort, command: SweepCommand | NoiseCommand, each: Callable[[SampleBlock], object] = lambda _: None
) -> None:
    """Run a sweep or noise to its end, calling `each` with every block."""
    run = port.run_noise(command) if isinstance(command, NoiseCommand) else port.run_sweep(command)
    async for block in run:
        each(block)


@asynccontextmanager
async def closing(port: DrivePort) -> AsyncGenerator[DrivePort]:
    """Closed in any case: an open one is the trouble of every test after it."""
    try:
        yield port
    finally:
        await port.close()


async def eventually(condition: Callable[[], bool], within: float = 20.0) -> None:
    """Wait for a condition, s."""
    deadline = time.monotonic() + within
    while not condition():
        assert time.monotonic() < deadline, "condition never came true"
        await asyncio.sleep(0.01)


def column(blocks: list[SampleBlock], name: str) -> NDArray[np.float64]:
    """One column of all blocks."""
    return np.concatenate([getattr(block, name) for block in blocks])
