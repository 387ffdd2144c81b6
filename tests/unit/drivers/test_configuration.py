"""Settling objects against a real SDO server (canopen's LocalNode) on python-can's virtual bus."""

import uuid
from collections.abc import Iterator
from dataclasses import dataclass

import can
import canopen
import pytest
from canopen.objectdictionary import ObjectDictionary, ODVariable, datatypes
from canopen.sdo.client import SdoClient

from drivers.canopen.bus import CanopenBus
from drivers.canopen.device_map import STANDARD, Entry
from drivers.canopen.profile import BusProfile
from drivers.canopen.sdo import Sdo
from drivers.errors import WrongConfiguration


@dataclass(frozen=True)
class Desk:
    sdo: Sdo
    client: SdoClient
    node: canopen.LocalNode


def dictionary() -> ObjectDictionary:
    """Has 1006h, 1019h, 6072h, and 6085h as a constant; lacks 6080h."""
    content = ObjectDictionary()
    for index, data_type, access in (
        (0x1006, datatypes.UNSIGNED32, "rw"),
        (0x1019, datatypes.UNSIGNED8, "rw"),
        (0x6072, datatypes.UNSIGNED16, "rw"),
        (0x6085, datatypes.UNSIGNED32, "ro"),
        (0x605A, datatypes.INTEGER16, "rw"),
    ):
        variable = ODVariable(f"object {index:04X}", index)
        variable.data_type = data_type
        variable.access_type = access
        variable.default = 7
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
    client = bus.add_node(1, None)
    yield Desk(Sdo(client, "joint_1 (node 1)", bus.check_alive), client, node)
    bus.close()
    server.disconnect()


def test_a_constant_is_accepted_only_with_the_wanted_value(desk: Desk) -> None:
    assert desk.sdo.settle_all(((STANDARD["quick_stop_deceleration"], 7),)) == frozenset()
    with pytest.raises(WrongConfiguration, match=r"6085h:00 quick stop deceleration = 8: .*read only"):
        desk.sdo.settle_all(((STANDARD["quick_stop_deceleration"], 8),))


def test_a_drive_that_holds_something_else_is_wrong(desk: Desk) -> None:
    def clamped(*, index: int, subindex: int, od: ODVariable) -> int | None:
        del subindex, od
        return 400 if index == STANDARD["max_torque"].index else None

    desk.node.add_read_callback(clamped)
    with pytest.raises(WrongConfiguration, match="6072h:00 max torque: wrote 500, drive holds 400"):
        desk.sdo.settle_all(((STANDARD["max_torque"], 500),))


def test_a_value_of_another_size_or_range_is_wrong(desk: Desk) -> None:
    with pytest.raises(WrongConfiguration, match="cannot hold 70000"):
        desk.sdo.write(STANDARD["max_torque"], 70_000)
    with pytest.raises(WrongConfiguration, match="another type"):
        desk.sdo.read(Entry(0x6072, 0, "I", "max torque as 32 bits"))


def test_a_sync_counter_is_switched_off_while_the_sync_period_is_0(desk: Desk) -> None:
    """CiA 301, 7.5.2.22: 1019h may be changed only then."""
    written: list[tuple[int, bytes]] = []
    desk.node.add_write_callback(lambda index, data, **_: written.append((index, bytes(data))))
    desk.sdo.settle_sync()
    assert written == [(0x1006, bytes(4)), (0x1019, b"\0")]
    desk.sdo.settle_sync()
    assert len(written) == 2
