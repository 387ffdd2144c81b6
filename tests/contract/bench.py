"""A real virtual machine on a real bus for every adapter; the suite itself knows only `DrivePort` and this bench."""

import asyncio
import json
import os
import socket
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from drivers.ports import DrivePort, SampleBlock, Sine, SweepCommand, SweepMode
from drivers.registry import load_profile, open_drive
from simulator.machine import Machine
from simulator.scenario import load_scenario
from simulator.virtual_drive import VirtualDrive

ROOT = Path(__file__).parents[2]
DRIVES = ROOT / "config" / "drives"
SCENARIO = ROOT / "config" / "scenarios" / "max100-full.yaml"
EDS = ROOT / "config" / "eds" / "virtual-axis.eds"
SPEED_FACTOR = 20.0

AXIS, OTHER = "joint_1", "joint_3"


@dataclass(frozen=True)
class Virtual:
    """A running virtual machine: its profile, and its control port for faults to order and for the truth."""

    profile: Mapping[str, object]
    control_port: int

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

    def open(self) -> DrivePort:
        return open_drive(self.profile, DRIVES)


def _profile(**bus: object) -> dict[str, object]:
    profile = load_profile(DRIVES / "virtual-max100.yaml")
    profile["bus"] = {**cast("dict[str, object]", profile["bus"]), **bus}
    return profile


@contextmanager
def socketcand_machine() -> Iterator[tuple[subprocess.Popen[bytes], Virtual]]:
    """`sweepid drive` in a process of its own."""
    command = [str(Path(sys.executable).with_name("sweepid")), "drive", "--scenario", str(SCENARIO), "--eds", str(EDS)]
    command += ["--port", "0", "--speed-factor", str(SPEED_FACTOR)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, cwd=ROOT) as process:
        try:
            assert process.stdout is not None
            ready = json.loads(process.stdout.readline())
            yield process, Virtual(_profile(port=ready["port"]), ready["control_port"])
        finally:
            process.terminate()


@contextmanager
def _over_socketcand() -> Iterator[Virtual]:
    with socketcand_machine() as (process, virtual):
        yield virtual
    assert process.returncode == 0


@contextmanager
def _in_one_process() -> Iterator[Virtual]:
    channel = f"contract-{os.getpid()}-{uuid.uuid4()}"
    virtual = VirtualDrive(
        Machine(load_scenario(SCENARIO), 0), EDS, bus="virtual", channel=channel, speed_factor=SPEED_FACTOR
    )
    thread = threading.Thread(target=virtual.run, name="virtual-drive")
    thread.start()
    try:
        profile = _profile(interface="virtual", channel=channel, host=None, port=None)
        yield Virtual(profile, virtual.control_port)
    finally:
        virtual.stop()
        thread.join()
        virtual.close()


BENCHES: dict[str, Callable[[], AbstractContextManager[Virtual]]] = {
    "canopen-socketcand": _over_socketcand,
    "canopen-virtual": _in_one_process,
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
        "sample_rate": 250.0,
        "velocity_limit": 0.05,
        "effort_limit": 5000.0,
        "position_window": (start - 0.5, start + 0.5),
    }
    return SweepCommand(**(fields | changes))  # pyright: ignore[reportArgumentType]


async def consume(
    port: DrivePort, command: SweepCommand, each: Callable[[SampleBlock], object] = lambda _: None
) -> None:
    """Run a sweep to its end, calling `each` with every block."""
    async for block in port.run_sweep(command):
        each(block)


async def eventually(condition: Callable[[], bool], within: float = 10.0) -> None:
    """Wait for a condition, s."""
    deadline = time.monotonic() + within
    while not condition():
        assert time.monotonic() < deadline, "condition never came true"
        await asyncio.sleep(0.01)


def column(blocks: list[SampleBlock], name: str) -> NDArray[np.float64]:
    """One column of all blocks."""
    return np.concatenate([getattr(block, name) for block in blocks])
