"""A second host on the bus is heard at any time while connected: a latched stop that names what was seen."""

import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.canopen import frames
from drivers.cia402 import states
from service.client import ServiceClient
from tests.system.bus_listener import SDO_REQUEST, Ear, listening
from tests.system.rest_bench import (
    Fieldbus,
    Service,
    VirtualMachine,
    add_plan,
    release,
    serving,
    until,
    virtual_machine,
)

AXIS = "joint_1"
HOST = 127
WATCHED = 1.0  # s

WORDS = {
    "heartbeat with node number 127, which this host uses (COB-ID 77Fh)": (
        frames.HEARTBEAT + HOST,
        bytes([frames.OPERATIONAL]),
    ),
    "SYNC (COB-ID 080h)": (frames.SYNC, b""),
    "NMT command 01h to every node (COB-ID 000h)": (frames.NMT, b"\x01\x00"),
    "RPDO1 to node 2 (COB-ID 202h)": (frames.RPDO1 + 2, frames.rpdo1(states.ENABLE_OPERATION, 0)),
    "SDO request to node 3 (COB-ID 603h)": (SDO_REQUEST + 3, bytes.fromhex("4041600000000000")),
}


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> Iterator[VirtualMachine]:
    with virtual_machine(tmp_path_factory.mktemp("machine"), 4.0) as machine:
        yield machine


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory, machine: VirtualMachine) -> Iterator[Service]:
    with serving(tmp_path_factory.mktemp("service"), machine.profile) as service:
        yield service


@pytest.fixture(scope="module")
def client(service: Service) -> Iterator[ServiceClient]:
    with ServiceClient(service.url) as client:
        yield client


@pytest.fixture(scope="module")
def ear(machine: VirtualMachine) -> Iterator[Ear]:
    with listening(machine) as ear:
        yield ear


def released(client: ServiceClient) -> None:
    release(client)
    for axis in client.drives()["axes"]:
        if axis["fault"]:
            client.acknowledge(axis["joint"])


def latched(client: ServiceClient, what: str) -> str:
    """Why, once the database has it."""
    until(lambda: [stop["id"] for stop in client.stops() if stop["id"] > 0], f"{what}: latched")
    (stop,) = client.stops()
    assert stop["by"] == "host watch"
    return str(stop["why"])


@pytest.mark.parametrize("modes", ["drive_side", "host_streamed"])
@pytest.mark.parametrize("what", WORDS)
def test_a_word_of_another_host_stops_what_moves(
    machine: VirtualMachine, client: ServiceClient, ear: Ear, what: str, modes: str
) -> None:
    campaign = int(client.add_campaign(add_plan(client, axes=[AXIS], poses=1, modes=modes))["id"])
    client.start(campaign)
    streamed = [AXIS] if modes == "host_streamed" else machine.axes()
    until(lambda: any(machine.axes()[joint]["velocity"] != 0 for joint in streamed), "it moves")
    ear.say(*WORDS[what])
    assert latched(client, what).startswith(f"another host is on the bus: {what}; ")
    until(lambda: client.campaign(campaign)["state"] == "paused", "campaign paused")
    assert what in client.campaign(campaign)["cause"]
    until(machine.stands, "the axes stand")
    keeps_standing(machine, ear)
    released(client)
    client.abort(campaign, "enough seen")


def test_an_idle_machine_hears_it_as_well(machine: VirtualMachine, client: ServiceClient, ear: Ear) -> None:
    assert client.drives()["capabilities"]["hears_other_hosts"] is True
    for what, word in WORDS.items():
        ear.say(*word)
        assert what in latched(client, what)
        released(client)
    assert machine.stands()


def test_an_axis_that_another_host_enabled_is_brought_down(
    machine: VirtualMachine, client: ServiceClient, ear: Ear
) -> None:
    ear.say(frames.NMT, b"\x01\x01")
    for controlword in (states.SHUTDOWN, states.SWITCH_ON, states.ENABLE_OPERATION):
        ear.say(SDO_REQUEST + 1, bytes.fromhex("2b406000") + controlword.to_bytes(2, "little") + bytes(2))
    latched(client, "enabled")
    until(machine.stands, "brought down")
    released(client)


def test_words_of_a_stop_are_nobodys_trespass(client: ServiceClient, ear: Ear) -> None:
    for frame in frames.stop(range(1, 7), range(1, 7)):
        ear.say(*frame)
    end = time.monotonic() + WATCHED
    while time.monotonic() < end:
        assert client.stops() == []
        time.sleep(0.02)


def keeps_standing(machine: VirtualMachine, ear: Ear) -> None:
    ear.forget()
    end = time.monotonic() + WATCHED
    while time.monotonic() < end:
        assert machine.stands()
        time.sleep(0.02)
    assert ear.words_of_motion() == []


@pytest.fixture
def modbus(tmp_path: Path) -> Iterator[VirtualMachine]:
    with virtual_machine(tmp_path, 4.0, Fieldbus.MODBUS_TCP) as machine:
        yield machine


def test_modbus_tells_that_it_hears_nobody_else(tmp_path: Path, modbus: VirtualMachine) -> None:
    with serving(tmp_path, modbus.profile) as service, ServiceClient(service.url) as other:
        assert other.drives()["capabilities"]["hears_other_hosts"] is False
