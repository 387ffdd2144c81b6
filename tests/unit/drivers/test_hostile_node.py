"""Whatever a node answers is a value or an error of ours; a second host under one node id does not get far."""

import asyncio
import contextlib
import queue
import threading
import uuid
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import can
import pytest
from canopen.sdo.client import SdoClient
from hypothesis import HealthCheck, example, given, settings, strategies as st

from drivers.canopen import frames
from drivers.canopen.bus import CanopenBus
from drivers.canopen.fieldbus import CanopenFieldbus
from drivers.canopen.profile import STANDARD, BusProfile, parse_profile
from drivers.canopen.sdo import Sdo
from drivers.contract.bench import eventually
from drivers.errors import CommunicationLost, ConnectionFailed, DriveError
from drivers.registry import load_profile
from tests.unit.drivers.test_bus import soon

pytestmark = pytest.mark.slow

NODE = 1
# commands of an SDO server: uploads, downloads, segments, block transfer, abort; with other bytes than it would send
COMMAND = st.sampled_from([0x43, 0x4F, 0x41, 0x40, 0x60, 0x20, 0x00, 0x01, 0x10, 0x11, 0xC6, 0xC2, 0xC1, 0xA1, 0x80])
OBJECT = st.just(bytes.fromhex("641000")) | st.just(bytes.fromhex("102103")) | st.binary(min_size=3, max_size=3)
ANSWER = st.builds(
    lambda command, index, data: bytes([command]) + index + data,
    COMMAND | st.integers(0, 255),
    OBJECT,
    st.sampled_from([bytes(4), b"\x08\x00\x00\x00", b"\xff\xff\xff\xff"]) | st.binary(min_size=4, max_size=4),
)


IMPATIENT, PATIENT = 0.03, 20.0  # s


@dataclass
class Desk:
    bus: CanopenBus
    client: SdoClient
    sdo: Sdo
    answers: "queue.SimpleQueue[bytes]"

    def settle(self) -> None:
        """Until nothing is under way any more that either side said, also on a busy computer."""
        self.bus.note_configured(NODE)
        self.bus.send(frames.Cob.NMT, bytes([0x81, NODE]))  # reset
        soon(lambda: self.bus.restarted(NODE))


@pytest.fixture
def desk() -> Iterator[Desk]:
    """A client, and a node that says what it is told to say, one answer a request; an abort is not answered.

    NMT is answered by the boot-up message.
    """
    channel = f"hostile-{uuid.uuid4()}"
    answers: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    node = can.Bus(interface="virtual", channel=channel)

    def answer(message: can.Message) -> None:
        if message.arbitration_id == frames.Cob.NMT:
            node.send(can.Message(arbitration_id=frames.Cob.HEARTBEAT + NODE, data=[0], is_extended_id=False))
        if message.arbitration_id == 0x600 + NODE and message.data[0] != 0x80 and not answers.empty():
            said = answers.get()
            for one in (said[:8], said[8:]) if len(said) > 8 else (said,):
                node.send(can.Message(arbitration_id=frames.Cob.SDO_RESPONSE + NODE, data=one, is_extended_id=False))

    listening = can.Notifier(node, [answer], timeout=0.05)
    bus = CanopenBus(BusProfile(interface="virtual", channel=channel, drive_timeout=3600.0), (NODE,))
    client = bus.add_node(NODE, None)
    yield Desk(bus, client, Sdo(client, "joint_1 (node 1)", bus.check_alive), answers)
    bus.close()
    listening.stop()
    node.shutdown()


REQUESTS: dict[str, Callable[[Sdo], object]] = {
    "read": lambda sdo: sdo.read(STANDARD["position"]),
    "write": lambda sdo: sdo.write(STANDARD["controlword"], 0),
    "segments": lambda sdo: sdo.upload(0x2110, 3, block=False),
    "blocks": lambda sdo: sdo.upload(0x2110, 3, block=True),
}


@pytest.mark.parametrize("request_name", REQUESTS)
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(answers=st.lists(ANSWER, max_size=4))
@example(answers=[bytes.fromhex("c610210300000000")])  # begins a block upload, and nothing comes
def test_any_answer_ends_in_a_value_or_an_error_of_ours(desk: Desk, request_name: str, answers: list[bytes]) -> None:
    for each in answers:
        desk.answers.put(each)
    desk.client.RESPONSE_TIMEOUT = IMPATIENT
    with contextlib.suppress(DriveError):
        REQUESTS[request_name](desk.sdo)
    while not desk.answers.empty():
        desk.answers.get()
    desk.settle()
    desk.client.RESPONSE_TIMEOUT = PATIENT
    desk.answers.put(bytes.fromhex("4364600007000000"))
    assert desk.sdo.read(STANDARD["position"]) == 7


@pytest.mark.parametrize(("request_name", "answer"), [("read", "4364600007000000"), ("write", "6040600000000000")])
def test_an_answer_that_the_stop_process_asked_for_is_no_lost_communication(
    desk: Desk, request_name: str, answer: str
) -> None:
    """Two clients ask one node: found by a stop in virtual time, whose axis was then not confirmed."""
    desk.client.RESPONSE_TIMEOUT = PATIENT
    for others in ("4b41600050020000", "8041600000000706"):  # the statusword, and that it is refused
        desk.answers.put(bytes.fromhex(others + answer))
        assert REQUESTS[request_name](desk.sdo) == {"read": 7, "write": None}[request_name]


DRIVES = Path(__file__).parents[3] / "config" / "drives"
WAIT = 20.0  # s
WORD = can.Message(arbitration_id=frames.Cob.HEARTBEAT + 127, data=[frames.NmtState.OPERATIONAL], is_extended_id=False)


@pytest.fixture
def peer() -> Iterator[tuple[can.BusABC, CanopenFieldbus]]:
    """Another host on the bus, and ours, not yet open; the drives of the profile are not there."""
    channel = f"hosts-{uuid.uuid4()}"
    line = {"interface": "virtual", "channel": channel, "host_heartbeat": 0.3, "drive_timeout": WAIT}
    raw = load_profile(DRIVES / "virtual-max100.yaml") | {"bus": line | {"sdo_timeout": 0.1}}
    with can.Bus(interface="virtual", channel=channel) as bus:
        yield bus, CanopenFieldbus(parse_profile(raw, DRIVES))


def heard(bus: can.BusABC) -> set[int]:
    return {message.arbitration_id for message in iter(lambda: bus.recv(0.0), None)}


async def test_where_another_host_speaks_nothing_is_sent(peer: tuple[can.BusABC, CanopenFieldbus]) -> None:
    bus, ours = peer
    beating = bus.send_periodic(WORD, 0.01)
    with pytest.raises(ConnectionFailed, match="another host speaks as node 127"):
        await ours.open()
    beating.stop()
    assert heard(bus) == set()


async def test_one_word_of_a_host_that_is_gone_keeps_nobody_away(peer: tuple[can.BusABC, CanopenFieldbus]) -> None:
    bus, ours = peer
    opening = asyncio.create_task(ours.open())
    await eventually(lambda: any(thread.name == "can-receive" for thread in threading.enumerate()), WAIT)
    bus.send(WORD)  # a gateway had held it back
    with pytest.raises(CommunicationLost):  # of the drives that are not there
        await opening
    assert heard(bus) >= {WORD.arbitration_id, frames.Cob.NMT}
