"""Settling objects against a real SDO server (canopen's LocalNode) on python-can's virtual bus."""

import uuid
from collections.abc import Iterator
from dataclasses import dataclass

import can
import canopen
import pytest
from canopen.objectdictionary import ObjectDictionary, ODVariable, datatypes

from drivers.canopen.bus import CanopenBus
from drivers.canopen.profile import STANDARD, BusProfile, Entry
from drivers.canopen.sdo import Sdo
from drivers.errors import WrongConfiguration


@dataclass(frozen=True)
class Desk:
    sdo: Sdo
    node: canopen.LocalNode


def dictionary() -> ObjectDictionary:
    """Has 1006h, 1019h, 6072h, and 6085h as a constant; lacks 6080h."""
    content = ObjectDictionary()
    for index, data_type, access in (
        (0x1006, datatypes.UNSIGNED32, "rw"),
        (0x1019, datatypes.UNSIGNED8, "rw"),
        (0x6072, datatypes.UNSIGNED16, "rw"),
        (0x6085, datatypes.UNSIGNED32, "ro"),
    ):
        variable = ODVariable(f"object {index:04X}", index)
        variable.data_type, variable.access_type, variable.default = data_type, access, 7
        content.add_object(variable)
    return content


@pytest.fixture
def desk() -> Iterator[Desk]:
    channel = f"configuration-{uuid.uuid4()}"
    server = canopen.Network(can.Bus(interface="virtual", channel=channel))
    server.NOTIFIER_CYCLE = 0.05
    server.connect()
    node = server.create_node(1, dictionary())
    bus = CanopenBus(BusProfile(interface="virtual", channel=channel, sdo_timeout=5.0, drive_timeout=60.0), (1, 2))
    yield Desk(Sdo(bus.add_node(1, None), "joint_1 (node 1)", bus.check_alive), node)
    bus.close()
    server.disconnect()


def test_what_a_drive_does_not_hold_is_wrong(desk: Desk) -> None:
    deceleration, torque = STANDARD["quick_stop_deceleration"], STANDARD["max_torque"]
    assert desk.sdo.settle_all(((deceleration, 7),)) == frozenset()  # a constant
    with pytest.raises(WrongConfiguration, match=r"6085h:00 quick stop deceleration = 8: .*read only"):
        desk.sdo.settle_all(((deceleration, 8),))
    with pytest.raises(WrongConfiguration, match="cannot hold 70000"):
        desk.sdo.write(torque, 70_000)
    with pytest.raises(WrongConfiguration, match="another type"):
        desk.sdo.read(Entry(torque.index, 0, "I", "max torque as 32 bits"))
    desk.node.add_read_callback(lambda index, **_: 400 if index == torque.index else None)
    with pytest.raises(WrongConfiguration, match="6072h:00 max torque: wrote 500, drive holds 400"):
        desk.sdo.settle_all(((torque, 500),))


def test_a_sync_counter_is_switched_off_while_the_sync_period_is_0(desk: Desk) -> None:
    """CiA 301, 7.5.2.22: 1019h may be changed only then."""
    written: list[tuple[int, bytes]] = []
    desk.node.add_write_callback(lambda index, data, **_: written.append((index, bytes(data))))
    for _ in range(2):
        desk.sdo.settle_sync()
    assert written == [(0x1006, bytes(4)), (0x1019, b"\0")]
