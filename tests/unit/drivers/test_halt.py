"""What needs no answer goes to all axes before one of them is asked anything, and on a bus where nobody is heard."""

import asyncio
import uuid
from pathlib import Path

import can
import pytest

from drivers.canopen import frames
from drivers.canopen.bus import Bus
from drivers.canopen.profile import parse_profile
from drivers.cia402 import states
from drivers.errors import CommunicationLost
from drivers.registry import load_profile
from tests.unit.drivers.small_servo import PATIENCE, Gate, Servo, connected

DRIVES = Path(__file__).parents[3] / "config" / "drives"


async def test_no_axis_waits_for_the_answer_of_another() -> None:
    gate = Gate("statusword")
    async with connected(Servo("joint_1", before=gate), Servo("joint_2")) as (port, link):
        before = link.halted
        gate.shut()
        stop = asyncio.create_task(port.stop())
        await gate.reached()  # the first drive was asked and has not answered
        assert link.halted == before + 1
        gate.open()
        assert set(await asyncio.wait_for(stop, PATIENCE)) == {"joint_1", "joint_2"}


def test_a_bus_on_which_nobody_is_heard_still_takes_the_stop() -> None:
    channel = f"halt-{uuid.uuid4()}"
    bus = {"interface": "virtual", "channel": channel, "host_heartbeat": 0.01, "drive_heartbeat": 0.01}
    profile = parse_profile(
        load_profile(DRIVES / "virtual-max100.yaml") | {"bus": bus | {"drive_timeout": 0.02}}, DRIVES
    )
    with can.Bus(interface="virtual", channel=channel) as peer:
        ours = Bus(profile.bus, (1, 2))
        try:
            while not ours.silent(1):
                pass
            with pytest.raises(CommunicationLost):
                ours.check_alive()
            with pytest.raises(CommunicationLost):
                ours.send(frames.SYNC, b"")
            for identifier, data in frames.stop([1, 2], deaf=[2]):
                ours.shout(identifier, data)
        finally:
            ours.close()
        heard = []
        while (message := peer.recv(0.0)) is not None:
            heard.append((message.arbitration_id, bytes(message.data)))
    quick_stop = frames.rpdo1(states.QUICK_STOP, 0)
    assert heard == [(0x201, quick_stop), (0x202, quick_stop), (frames.SYNC, b""), (frames.NMT, b"\x02\x02")]
