"""A stop, closing or disabling does not wait until a drive is enabled: no further step is told to it."""

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

import pytest

from drivers.cia402 import states
from drivers.cia402.machine import Cia402Machine
from drivers.errors import SweepInterrupted
from tests.unit.drivers.small_servo import PATIENCE, Gate, Servo, connected, eventually

WAYS: dict[str, Callable[[Cia402Machine], Awaitable[object]]] = {
    "stop": lambda port: port.stop(),
    "close": lambda port: port.close(),
    "disable": lambda port: port.disable("joint_2"),
}


@pytest.mark.parametrize("way", WAYS.values(), ids=WAYS)
async def test_no_further_step_is_told_to_a_drive(way: Callable[[Cia402Machine], Awaitable[object]]) -> None:
    gate = Gate("control 07")
    first, second = Servo("joint_1"), Servo("joint_2", before=gate)
    async with connected(first, second) as (port, link):
        gate.shut()
        enabling = asyncio.create_task(port.enable("joint_1", "joint_2"))
        await gate.reached()
        assert first.energised
        asked = link.thread.asked
        ending = asyncio.ensure_future(way(port))
        await eventually(lambda: link.thread.asked > asked)  # and waits for it
        gate.open()
        with pytest.raises(SweepInterrupted, match="stopped while it was being enabled"):
            await asyncio.wait_for(enabling, PATIENCE)
        await asyncio.wait_for(ending, PATIENCE)
        assert states.ENABLE_OPERATION not in second.told
        assert [first.energised, second.energised] == [False, False]


@dataclass
class Stuck(Servo):
    """Stays "ready to switch on"."""

    def control(self, controlword: int) -> None:
        if controlword == states.SWITCH_ON:
            self.told.append(controlword)
        else:
            super().control(controlword)


async def test_a_stop_does_not_wait_for_a_step_that_the_drive_does_not_take(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.cia402.axis.TRANSITION_TIMEOUT", 2 * PATIENCE)
    servo = Stuck("joint_1")
    async with connected(servo) as (port, _):
        enabling = asyncio.create_task(port.enable("joint_1"))
        await eventually(lambda: states.SWITCH_ON in servo.told)
        await asyncio.wait_for(port.stop(), PATIENCE)
        with pytest.raises(SweepInterrupted):
            await asyncio.wait_for(enabling, PATIENCE)
        assert servo.told[-1] == states.DISABLE_VOLTAGE
        await port.enable()  # what was stopped is over: the next is not
