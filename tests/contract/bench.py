"""A real virtual machine on a real bus for every adapter; the suite itself knows only `DrivePort` and this bench."""

import json
import math
import os
import signal
import subprocess
import sys
import threading
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, cast
from unittest.mock import patch

import pytest

from drivers import contract
from drivers.modbus.line import MasterLine
from drivers.ports import DrivePort, NoiseCommand, SweepCommand, SweepMode
from drivers.registry import load_profile, open_drive
from simulator.machine import LiveMachine
from simulator.scenario import load_scenario
from simulator.virtual_drive import VirtualDrive
from tests.contract import makers
from tests.foreign_bench import bench as foreign_bench
from tests.independent_bench import machine as independent_machine
from tests.ports import ordered

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
        return ordered(self.control_port, order, **fields)

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


def leave_out(config: pytest.Config, items: list[pytest.Item]) -> None:
    """A hook: what a bench lacks is no test of it, and no skip."""
    vcan, every = bool(config.getoption("vcan")), bool(config.getoption("every_drive"))
    items[:] = [item for item in items if _exists(item, vcan, every)]


def _exists(item: pytest.Item, vcan: bool, every: bool) -> bool:
    given: dict[str, Any] = (
        item.callspec.params if isinstance(item, pytest.Function) and hasattr(item, "callspec") else {}
    )
    name = given.get("virtual", given.get("mortal"))
    if name is None:
        return not vcan or "vcan" in item.path.parts
    bench, adapter = BENCHES[name], item.get_closest_marker("adapter")
    return (
        bench.vcan is vcan
        and (every or not bench.alike)
        and (bench.own_process or "mortal" not in given)
        and (adapter is None or adapter.args == (bench.adapter,))
        and not contract.lacking(cast("pytest.Function", item).function, bench, given.get("mode"))
    )


@dataclass(frozen=True, kw_only=True)
class Bench(contract.Bench):
    """An adapter on a bus, and what there is to test with it."""

    axis: str = AXIS
    other: str | None = OTHER
    position_limits: tuple[float, float] = (-2.96, 2.96)
    velocity_limit: float = 1.0
    effort: float = 5000.0
    slow_effort: tuple[float, float] = (50.0, 400.0)  # Coulomb and viscous friction of axis 1
    least_effort: float = 100.0
    sync_period: float = SYNC_PERIOD
    amplitude: float = 0.0025  # at 4 Hz more than 5 steps of the coarsest position, a Powerball's

    adapter: str
    machine: Callable[["Bench"], AbstractContextManager[Virtual]]
    own_process: bool = True  # which can die
    vcan: bool = False  # needs a kernel with CAN: runs with --vcan, and then no other does
    alike: bool = False  # differs from another bench in bus or dictionary alone: runs with --every-drive


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
        LiveMachine(load_scenario(SCENARIO), 0), eds, bus="virtual", channel=channel, speed_factor=SPEED_FACTOR
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
        content = makers.profile(dictionary, foreign, DRIVES, patient=bench.vcan)  # the guest has one slow CPU
        yield Virtual(bench, content, foreign.control_port)


@contextmanager
def _of_stack(bench: Bench, stack: str, bus: str, modes: str) -> Iterator[Virtual]:
    """Nodes of a stack that neither this project nor python-canopen made, with plants of their own."""
    with independent_machine(stack, modes, bus=bus) as machine:
        yield Virtual(bench, machine.profile, machine.control_port, machine.process)


def _over_modbus_tcp(bench: Bench) -> AbstractContextManager[Virtual]:
    options = ("--fieldbus", "modbus-tcp", "--registers", str(REGISTERS / "virtual-high-first.yaml"), "--port", "0")
    name = "virtual-max100-modbus-tcp"
    return _process(bench, *options, profile=lambda ready: _profile(name, "line", port=ready["port"]))


@contextmanager
def _over_modbus_rtu(bench: Bench) -> Iterator[Virtual]:
    options = ("--fieldbus", "modbus-rtu", "--registers", str(REGISTERS / "virtual-low-first.yaml"), "--device", "pty")
    name = "virtual-max100-modbus-rtu"
    travel = {"travel_limits": {"rad": 9.0}}  # an axis may move for as long as the watchdog
    times = {"silence_between_frames": 0.002, "timeout": 4.0, "watchdog": 8.5}  # s; needs no silence; a busy computer
    rtu = _process(
        bench, *options, profile=lambda ready: _profile(name, "line", device=ready["device"], **times) | travel
    )
    with rtu as virtual, patch.object(MasterLine, "stop_timeout", times["timeout"]):
        yield virtual


BOTH, DRIVE_SIDE = frozenset(SweepMode), frozenset({SweepMode.DRIVE_SIDE})
STREAMED = BOTH - DRIVE_SIDE
ORDERS = frozenset({"fault", "emergency_stop", "silence", "limit", "glitch", "saturate", "reboot", "swap", "identity"})
FOREIGN_ORDERS = ORDERS | {"emcy", "drop_tpdos", "bus_off"}
INDEPENDENT_ORDERS = frozenset({"fault", "emergency_stop", "silence", "identity", "drop_tpdos", "reboot"})
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


def _canopen(machine: Callable[[Bench], AbstractContextManager[Virtual]], **more: Any) -> Bench:
    return Bench(
        adapter="canopen",
        modes=BOTH,
        orders=CAN_ORDERS,
        machine=machine,
        injects=True,
        exclusive=True,
        load_encoder=True,
        **more,
    )


def _modbus(machine: Callable[[Bench], AbstractContextManager[Virtual]], **more: Any) -> Bench:
    return Bench(adapter="modbus", modes=DRIVE_SIDE, orders=ORDERS, machine=machine, load_encoder=True, **more)


def _other_maker(dictionary: str, bus: str = "virtual", **more: Any) -> Bench:
    return Bench(
        adapter="canopen-402", modes=STREAMED, orders=FOREIGN_ORDERS, exclusive=True, own_process=False,
        machine=partial(_foreign, dictionary=dictionary, bus=bus), vcan=bus == "socketcan", **more,
    )  # fmt: skip


def _independent(stack: str, bus: str = "socketcand", modes: str = "csv", **more: Any) -> Bench:
    return Bench(
        adapter="independent", modes=STREAMED, orders=INDEPENDENT_ORDERS, exclusive=True, effort=2500.0,
        machine=partial(_of_stack, stack=stack, bus=bus, modes=modes), vcan=bus == "socketcan", **more,
    )  # fmt: skip


STEPS = 5.01  # of the position unit in an amplitude, with what a conversion rounds
LEAST_SINES = {  # rad; only positions have one
    "plain": 0.0,
    "epos4": 0.0,
    "gold": 0.0,
    "simpliq": STEPS * math.tau / (8192 * 171),  # axis 1's gear
    "powerball": STEPS * math.radians(1e-3),
}
BUSES = {"virtual": "virtual", "socketcand": "socketcand", "vcan": "socketcan"}

BENCHES: dict[str, Bench] = {
    "canopen-socketcand": _canopen(_over_socketcand),
    "canopen-virtual": _canopen(in_one_process, own_process=False),
    "canopen-vcan": _canopen(_over_vcan, vcan=True),
    "plain-virtual": _other_maker("plain"),
    "epos4-virtual": _other_maker("epos4"),  # the makers' dictionaries are in ../shared
    **{
        f"{dictionary}-{name}": _other_maker(dictionary, bus, least_sine=least, alike=True)
        for (dictionary, least), (name, bus) in product(LEAST_SINES.items(), BUSES.items())
        if (dictionary, name) not in (("plain", "virtual"), ("epos4", "virtual"))
    },
    "durand-socketcand": _independent("durand"),
    "durand-vcan": _independent("durand", "socketcan", alike=True),
    "node-socketcand": _independent("node-canopen"),
    "node-csp-socketcand": _independent("node-canopen", modes="csp", alike=True),
    "node-vcan": _independent("node-canopen", "socketcan"),
    "modbus-tcp": _modbus(_over_modbus_tcp),
    "modbus-rtu": _modbus(_over_modbus_rtu, exclusive=True),
}
ANY = BENCHES["canopen-virtual"]  # the axis and its sweeps are those of every bench


async def sweep(port: DrivePort, mode: SweepMode, periods: int = 2, **changes: object) -> SweepCommand:
    """A short sweep of `AXIS` from where it stands, with a window around that."""
    return await ANY.sweep(port, mode, periods, **changes)


async def noise(port: DrivePort, periods: int = 4, **changes: object) -> NoiseCommand:
    """A short noise run of `AXIS` from where it stands, 2 % of rated torque from 2 to 40 Hz."""
    return await ANY.noise(port, periods, **changes)
