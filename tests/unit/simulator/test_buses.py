"""The virtual drive on its buses, in this process: socketcand and python-can's own virtual bus."""

import selectors
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import can
import pytest

from simulator import Scenario
from simulator.canopen.line import CanBus
from simulator.canopen.pdo import Frame
from simulator.machine import LiveMachine
from simulator.virtual_drive import VirtualDrive

PATIENCE = 60.0  # s; a busy computer
EDS = Path(__file__).parents[3] / "config/eds/virtual-axis.eds"
READ_STATUSWORD = can.Message(arbitration_id=0x601, data=[0x40, 0x41, 0x60, 0, 0, 0, 0, 0], is_extended_id=False)


@contextmanager
def running(drive: VirtualDrive) -> Iterator[VirtualDrive]:
    thread = threading.Thread(target=drive.run)
    thread.start()
    try:
        yield drive
    finally:
        drive.stop()
        thread.join(PATIENCE)
        drive.close()
        assert not thread.is_alive()


@pytest.fixture
def machine(scenario: Callable[[str], Scenario]) -> LiveMachine:
    return LiveMachine(scenario("rigid"), 1)


def wait_for(bus: can.BusABC, identifier: int) -> bytes:
    while (message := bus.recv(PATIENCE)) is not None:
        if message.arbitration_id == identifier:
            return bytes(message.data)
    raise AssertionError(f"no frame {identifier:x}")


def test_clients_of_the_socketcand_server_share_the_bus(machine: LiveMachine) -> None:
    with running(VirtualDrive(machine, EDS)) as drive:
        buses = [
            can.Bus(interface="socketcand", host="127.0.0.1", port=drive.port, channel="can0", tcp_tune=True)
            for _ in range(3)
        ]
        first, second, third = buses
        try:
            for bus in buses:  # each has spoken, so each is on the bus
                bus.send(READ_STATUSWORD)
                wait_for(bus, 0x581)
            first.send(can.Message(arbitration_id=0x123, data=b"\x00\x0f\xf0\xff", is_extended_id=False))
            assert wait_for(second, 0x123) == b"\x00\x0f\xf0\xff"
            assert wait_for(third, 0x123) == b"\x00\x0f\xf0\xff"
            first.send(READ_STATUSWORD)
            while (message := first.recv(PATIENCE)) is not None and message.arbitration_id != 0x581:
                assert message.arbitration_id != 0x123  # no echo of its own
            extended = can.Message(arbitration_id=0x18FF1234, data=b"\x01", is_extended_id=True)
            second.send(extended)
            while (message := third.recv(PATIENCE)) is not None and not message.is_extended_id:
                pass
            assert message is not None
            assert message.arbitration_id == extended.arbitration_id
            second.shutdown()
            first.send(READ_STATUSWORD)
            assert wait_for(third, 0x581)[:4] == b"\x4b\x41\x60\x00"
        finally:
            first.shutdown()
            third.shutdown()
            second.shutdown()


def test_another_channel_is_refused(machine: LiveMachine) -> None:
    with running(VirtualDrive(machine, EDS)) as drive:
        assert drive.port is not None
        with socket.create_connection(("127.0.0.1", drive.port), timeout=PATIENCE) as client:
            assert client.recv(64) == b"< hi >"
            client.sendall(b"< open can7 >")
            assert client.recv(64) == b"< error no channel can7 here >"
            client.sendall(b"< send 080 0 >")
            assert client.recv(64) == b"< error unknown command >"  # not before < rawmode >
            client.sendall(b"GET / HTTP/1.1\r\n" + b"x" * 300)
            assert client.recv(64) == b""


def test_a_bus_that_is_off_says_so_once_and_passes_nothing_either_way() -> None:
    selector, received = selectors.SelectSelector(), list[Frame]()
    bus = CanBus(selector, "virtual", "test bus-off", received.append)

    def turn() -> None:
        for key, _ in selector.select(PATIENCE):
            key.data(0)

    with can.Bus(interface="virtual", channel="test bus-off") as peer:
        peer.send(READ_STATUSWORD)
        turn()
        assert [frame.id for frame in received] == [0x601]
        for _ in range(2):
            bus.switch_off(off=True)
        bus.send(Frame(0x181, b"\1"))
        peer.send(READ_STATUSWORD)
        turn()
        bus.switch_off(off=False)
        bus.send(Frame(0x182, b"\2"))
        heard = [peer.recv(PATIENCE) for _ in range(2)]
        assert [(each.arbitration_id, each.is_error_frame) for each in heard if each] == [(0x40, True), (0x182, False)]
    assert len(received) == 1
    bus.close()
    selector.close()
