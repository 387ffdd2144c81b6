"""The drives of the machine in virtual time, without a service."""

import pytest

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
