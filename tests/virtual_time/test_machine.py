"""The drives of the machine in virtual time, without a service."""

from pathlib import Path

import pytest

from drivers.ports import SweepMode
from tests.contract.bench import BENCHES
from tests.virtual_time.clock import Clock
from tests.virtual_time.machine import VirtualMachine


@pytest.mark.parametrize("machine", ["canopen", "modbus"], indirect=True)
async def test_a_move_takes_the_time_that_its_speed_says(machine: VirtualMachine, clock: Clock) -> None:
    port = machine.open()
    await port.connect()
    await port.acknowledge("joint_1")
    await port.enable("joint_1")
    began = clock.now
    await port.move_to("joint_1", 1.0, 0.5)
    assert 2.5 < clock.now - began < 6.0  # with the rest at its end
    assert abs(machine.axes()["joint_1"]["position"] - 1.0) < 1e-3
    await port.disable("joint_1")
    assert machine.stands()
    await port.close()


@pytest.mark.parametrize("fieldbus", ["canopen", "modbus"])
async def test_no_motion_fails_for_a_machine_that_cannot_keep_up(tmp_path: Path, fieldbus: str, clock: Clock) -> None:
    """Its clock runs at a quarter of the host's: each motion takes four times as long, and ends as planned."""
    machine = VirtualMachine(tmp_path, fieldbus, speed_factor=0.25)
    port = machine.open()
    await port.connect()
    await port.acknowledge("joint_1")
    await port.enable("joint_1")
    began = clock.now
    for target in (1.0, -0.5):
        await port.move_to("joint_1", target, 0.5)
        assert abs(machine.axes()["joint_1"]["position"] - target) < 1e-3
    assert clock.now - began > 20.0
    bench = BENCHES["canopen-virtual"]
    recorded = [block async for block in port.run_sweep(await bench.sweep(port, SweepMode.DRIVE_SIDE, periods=2))]
    assert recorded
    await port.disable("joint_1")
    await port.close()
