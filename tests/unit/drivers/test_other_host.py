"""Two hosts under one node id would each keep the drives from missing the other: the second does not get that far."""

import asyncio
import threading
import uuid
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import can
import pytest

from drivers.canopen import frames
from drivers.canopen.fieldbus import CanopenFieldbus
from drivers.canopen.profile import parse_profile
from drivers.errors import CommunicationLost, ConnectionFailed
from drivers.registry import load_profile

pytestmark = pytest.mark.slow

DRIVES = Path(__file__).parents[3] / "config" / "drives"
BEAT = 0.3  # s
PATIENCE = 20.0  # s
WORD = can.Message(arbitration_id=frames.HEARTBEAT + 127, data=[frames.OPERATIONAL], is_extended_id=False)


@dataclass(frozen=True)
class Peer:
    """Another host on the bus; the drives of the profile are not there."""

    channel: str
    bus: can.BusABC

    def fieldbus(self) -> CanopenFieldbus:
        bus = {"interface": "virtual", "channel": self.channel, "host_heartbeat": BEAT, "drive_timeout": PATIENCE}
        raw = load_profile(DRIVES / "virtual-max100.yaml")
        return CanopenFieldbus(parse_profile(raw | {"bus": bus | {"sdo_timeout": 0.1}}, DRIVES))

    def heard(self) -> set[int]:
        identifiers: set[int] = set()
        while (message := self.bus.recv(0.0)) is not None:
            identifiers.add(message.arbitration_id)
        return identifiers


@pytest.fixture
def peer() -> Iterator[Peer]:
    channel = f"hosts-{uuid.uuid4()}"
    with can.Bus(interface="virtual", channel=channel) as bus:
        yield Peer(channel, bus)


async def test_where_another_host_speaks_nothing_is_sent(peer: Peer) -> None:
    beating = peer.bus.send_periodic(WORD, 0.01)
    with pytest.raises(ConnectionFailed, match="another host speaks as node 127"):
        await peer.fieldbus().open()
    beating.stop()
    assert peer.heard() == set()


async def test_one_word_of_a_host_that_is_gone_keeps_nobody_away(peer: Peer) -> None:
    opening = asyncio.create_task(peer.fieldbus().open())
    async with asyncio.timeout(PATIENCE):
        while not any(thread.name == "can-receive" for thread in threading.enumerate()):  # noqa: ASYNC110
            await asyncio.sleep(0.002)
    peer.bus.send(WORD)  # a gateway had held it back
    with pytest.raises(CommunicationLost):  # of the drives that are not there
        await opening
    assert peer.heard() >= {WORD.arbitration_id, frames.NMT}
