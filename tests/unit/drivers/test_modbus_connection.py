"""The connection over both lines: heartbeat, loss, and what it refuses."""

import asyncio
import threading
import time
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any

import pytest

from drivers.errors import (
    CommunicationLost,
    NotReady,
    WrongIdentity,
)
from drivers.modbus import line as line_module
from drivers.modbus.fieldbus import ModbusConnection, ModbusFieldbus
from drivers.modbus.registers import RegisterMap
from drivers.ports import SweepMode
from tests.unit.drivers.modbus_bank import Bank, Request, serving
from tests.unit.drivers.modbus_drive import HIGH, KINDS, LOW, drive, following, profile_on

pytestmark = pytest.mark.slow

PATIENCE = 1.0  # s for a good answer: line and units share this process, and the computer
BEAT = PATIENCE / 2  # s; four in the watchdog's time


@asynccontextmanager
async def opened(kind: str) -> AsyncGenerator[tuple[Bank, ModbusConnection]]:
    registers = HIGH if kind == "tcp" else LOW
    bank = Bank(kind)
    for unit, torque in ((1, 17.544), (2, 18.717)):
        drive(bank, registers, unit, torque)
    following(bank, registers)
    with serving(bank, PATIENCE) as served:
        served = served.model_copy(update={"watchdog": 4 * BEAT})
        connection = await ModbusFieldbus(profile_on(served, kind, axes=2)).open()
        try:
            yield bank, connection
        finally:
            await connection.close()


async def eventually(condition: Any) -> None:
    deadline = time.monotonic() + 10
    while not condition():
        assert time.monotonic() < deadline, "condition never came true"
        await asyncio.sleep(0.01)


@KINDS
async def test_the_heartbeat_speaks_to_every_unit_and_notices_a_loss(
    kind: str, registers: RegisterMap, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(line_module, "LOOK_AGAIN", 0.3)
    async with opened(kind) as (bank, connection):
        assert connection.capabilities.sweep_modes == {SweepMode.DRIVE_SIDE}
        assert connection.capabilities.set_point_timing == "none"
        bank.requests.clear()
        await eventually(lambda: all([r.unit for r in bank.requests].count(unit) > 3 for unit in (1, 2)))
        assert {request.unit for request in bank.requests} == {1, 2}
        await eventually(lambda: not _lost(connection, "joint_2"))
        bank.spoil = lambda request, frame: None if request.unit == 2 else frame
        await eventually(lambda: _lost(connection, "joint_2") and not _lost(connection, "joint_1"))
        bank.spoil = lambda _, frame: frame
        await eventually(lambda: not _lost(connection, "joint_2"))


def _lost(connection: ModbusConnection, joint: str) -> bool:
    try:
        connection.axes[joint].device.check_alive()
    except CommunicationLost:
        return True
    return False


async def test_a_host_that_hangs_falls_silent() -> None:
    async with opened("tcp") as (bank, connection):
        bank.requests.clear()
        await eventually(lambda: len(bank.requests) > 0)
        # from here on the event loop hangs; a beat under way may end, and the thread has one at a time
        over, heard = threading.Event(), threading.Event()
        connection.thread.post(over.set)
        assert over.wait(10)

        def hear(_: Request, frame: bytes) -> bytes:
            heard.set()
            return frame

        bank.spoil = hear
        assert not heard.wait(3 * BEAT)
        await eventually(heard.is_set)


async def test_host_streamed_sweeps_are_refused() -> None:
    async with opened("tcp") as (_, connection):
        with pytest.raises(NotReady, match="not possible through Modbus"):
            await connection.stream([], threading.Event())


async def test_a_wrong_drive_leaves_nothing_open() -> None:
    bank = Bank("tcp")
    drive(bank, HIGH, 1, 99.0)
    following(bank, HIGH)
    with serving(bank, PATIENCE) as served:
        with pytest.raises(WrongIdentity, match="rated torque"):
            await ModbusFieldbus(profile_on(served, "tcp")).open()
        assert len(asyncio.all_tasks()) == 1
