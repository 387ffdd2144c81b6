"""Every adapter does what `drivers.contract` asks of a `DrivePort`, with the drives of the house on a bus in memory.

The wiring of each bus is shown in `tests/contract`, in real time.
"""

from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
import yaml

from drivers.contract import DrivePortSuite, FaultSuite, NoiseSuite
from drivers.contract.bench import connected_port
from drivers.ports import DrivePort
from tests.contract.bench import BENCHES, Virtual
from tests.virtual_time.clock import Clock
from tests.virtual_time.machine import VirtualMachine


@dataclass(frozen=True, kw_only=True)
class InMemory(Virtual):
    """A bench in virtual time: orders reach the machine without a control port."""

    machine: VirtualMachine
    control_port: int = field(default=0, init=False)

    def order(self, order: str, **fields: object) -> dict[str, Any]:
        return self.machine.order(order, **fields)

    def open(self) -> DrivePort:
        return self.machine.open()


@pytest.fixture(params=["canopen-virtual", "modbus-tcp"])
def virtual(clock: Clock, tmp_path: Path, request: pytest.FixtureRequest) -> Virtual:
    del clock
    bench = BENCHES[request.param]
    machine = VirtualMachine(tmp_path, bench.adapter)
    return InMemory(bench=bench, profile=yaml.safe_load(machine.profile.read_text("utf-8")), machine=machine)


@pytest.fixture
async def port(virtual: Virtual) -> AsyncIterator[DrivePort]:
    async for connected in connected_port(virtual):
        yield connected


class TestDrivePort(DrivePortSuite):
    """Connecting, moving, sweeps."""


class TestFaults(FaultSuite):
    """Where the drive, the bus or the axis misbehaves."""


class TestNoise(NoiseSuite):
    """Torque noise."""
