"""The heartbeat of the connection, and what a wrong drive leaves; contract and deaths of hosts show the rest."""

import asyncio
import threading

import pytest

from drivers.contract.bench import eventually
from drivers.errors import CommunicationLost, NotReady, WrongIdentity
from drivers.modbus import line as line_module
from drivers.modbus.fieldbus import ModbusConnection, ModbusFieldbus
from drivers.modbus.registers import RegisterMap
from tests.unit.drivers.modbus_bank import Bank, serving
from tests.unit.drivers.modbus_drive import HIGH, KINDS, drive, following, profile_on

pytestmark = pytest.mark.slow

PATIENCE = 1.0  # s for a good answer: line and units share this process, and the computer


@KINDS
async def test_the_heartbeat_speaks_to_every_unit_and_notices_a_loss(
    kind: str, registers: RegisterMap, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(line_module, "LOOK_AGAIN", 0.3)
    bank = Bank(kind)
    for unit, torque in ((1, 17.544), (2, 18.717)):
        drive(bank, registers, unit, torque)
    following(bank, registers)
    with serving(bank, PATIENCE) as served:
        served = served.model_copy(update={"watchdog": 2 * PATIENCE})
        connection = await ModbusFieldbus(profile_on(served, kind, axes=2)).open()
        with pytest.raises(NotReady, match="not possible through Modbus"):
            await connection.stream([], threading.Event())
        bank.requests.clear()
        await eventually(lambda: all([r.unit for r in bank.requests].count(unit) > 3 for unit in (1, 2)))
        bank.spoil = lambda request, frame: None if request.unit == 2 else frame
        await eventually(lambda: _lost(connection, "joint_2") and not _lost(connection, "joint_1"))
        bank.spoil = lambda _, frame: frame
        await eventually(lambda: not _lost(connection, "joint_2"))
        await connection.close()


def _lost(connection: ModbusConnection, joint: str) -> bool:
    try:
        connection.axes[joint].device.check_alive()
    except CommunicationLost:
        return True
    return False


async def test_a_wrong_drive_leaves_nothing_open() -> None:
    bank = Bank("tcp")
    drive(bank, HIGH, 1, 99.0)
    following(bank, HIGH)
    with serving(bank, PATIENCE) as served:
        with pytest.raises(WrongIdentity, match="rated torque"):
            await ModbusFieldbus(profile_on(served, "tcp")).open()
        assert len(asyncio.all_tasks()) == 1
