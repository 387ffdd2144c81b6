"""Set-points timed by the kernel, on a real SocketCAN interface (`tests/vcan/run`)."""

import subprocess
import threading
import time
from collections.abc import Iterator
from itertools import pairwise

import can
import numpy as np
import pytest

from drivers.canopen import frames
from drivers.canopen.bus import KernelStream, set_point_source
from drivers.canopen.streamed_axis import Ending
from drivers.errors import CommunicationLost
from drivers.ports import SampleBlock
from tests.unit.drivers.streaming_bench import OFF, Drive, bench, run_to_end

INTERFACE = "vcan0"
RPDO, REST = 0x201, bytes(4)


@pytest.fixture
def listener() -> Iterator[can.BusABC]:
    bus = can.Bus(interface="socketcan", channel=INTERFACE)
    yield bus
    bus.shutdown()


def plan(number: int) -> list[tuple[int, bytes]]:
    return [(RPDO, number.to_bytes(4, "little")), (frames.Cob.SYNC, b"")]


def until_silent(listener: can.BusABC) -> list[can.Message]:
    heard: list[can.Message] = []
    while (message := listener.recv(1.0)) is not None:
        heard.append(message)
    return heard


def planned(heard: list[can.Message]) -> list[int]:
    return [int.from_bytes(each.data, "little") for each in heard if each.arbitration_id == RPDO and each.data != REST]


def test_a_stream_that_nobody_tops_up_comes_to_rest_and_ends(listener: can.BusABC) -> None:
    started = time.monotonic()
    stream = KernelStream(INTERFACE, 0.01, lambda k: plan(k + 1), [(RPDO, REST), (frames.Cob.SYNC, b"")])
    stream.begin()
    heard = until_silent(listener)
    stream.close()
    assert time.monotonic() - started < 5.0
    assert [each.arbitration_id for each in heard] == [RPDO, frames.Cob.SYNC] * (len(heard) // 2) + [RPDO] * (
        len(heard) % 2
    )
    assert planned(heard) == list(range(1, 76))  # three quarters of a ring of 100 cycles
    resting = [each for each in heard if each.data == REST]
    assert 10 <= len(resting) <= 13
    assert resting[0] is heard[150]


def test_topping_up_neither_breaks_the_order_nor_sends_the_first_frames_again(listener: can.BusABC) -> None:
    stream = KernelStream(INTERFACE, 0.004, lambda k: plan(k + 1), [(RPDO, REST), (frames.Cob.SYNC, b"")])
    stream.begin()
    heard: list[can.Message] = []
    while (sent := sum(each.arbitration_id == frames.Cob.SYNC for each in heard)) < 500:
        message = listener.recv(1.0)
        assert message is not None
        heard.append(message)
        stream.note(0.0)
        stream.top_up(sent)
    stream.close()
    assert planned(heard) == list(range(1, len(planned(heard)) + 1))
    assert listener.recv(0.0) is None or len(until_silent(listener)) < 3  # at most what was on its way
    assert listener.recv(0.5) is None


def obeyed(drive: Drive) -> list[int]:
    return [target for controlword, target in drive.obeyed if controlword == 0x0F]


async def test_a_host_that_waits_for_answers_times_the_set_points_itself() -> None:
    """The kernel sends SYNC whether a drive has answered or not."""
    async with bench(Drive(1, counts=False), interface="socketcan", channel=INTERFACE, sync_period=0.02) as on:
        assert set_point_source(on.bus) == "bcm"
        assert set_point_source(on.bus, waits=True) == "thread"
        run = on.start(on.request(1, periods=3))
        await run_to_end(run)
        assert run.ending is Ending.COMPLETED, run.reason
        assert run.timing().source == "thread"


@pytest.mark.parametrize(("nodes", "period"), [(1, 0.01), (3, 0.02)])
async def test_a_sweep_timed_by_the_kernel_sends_every_set_point_once_and_in_order(nodes: int, period: float) -> None:
    drives = [Drive(node) for node in range(1, nodes + 1)]
    async with bench(*drives, interface="socketcan", channel=INTERFACE, sync_period=period) as on:
        assert set_point_source(on.bus) == "bcm"
        requests = [on.request(node, periods=10) for node in on.cabinet.drives]
        run = on.start(*requests)
        blocks = await run_to_end(run)
        assert run.ending is Ending.COMPLETED, run.reason
        count = round(requests[0].command.duration / period) + 1
        for request, drive in zip(requests, drives, strict=True):
            mine = [block for block in blocks if block.joint == request.axis.joint]
            index = np.concatenate([block.index for block in mine])
            set_point = np.concatenate([block.velocity_setpoint for block in mine])
            assert index.tolist() == list(range(count))
            assert np.concatenate([block.velocity for block in mine]) == pytest.approx(set_point, abs=0.5001e-3)
            assert obeyed(drive)[: count - 1] == [request.codec.raw_velocity(each) for each in set_point[1:]]
        timing = run.timing()
        assert timing.source == "bcm"
        assert timing.cycles >= count


async def test_a_stop_deletes_the_kernels_job_and_the_ladder_takes_over() -> None:
    stop = threading.Event()
    drives = (Drive(1), Drive(2))
    async with bench(*drives, interface="socketcan", channel=INTERFACE, sync_period=0.01) as on:
        run = on.start(on.request(1, periods=300), on.request(2, periods=300), stop=stop)
        await run_to_end(run, lambda _: stop.set())
        assert run.ending is Ending.STOPPED
        for drive in drives:
            assert (drive.statusword, drive.velocity) == (OFF, 0)
            assert drive.obeyed[-1] == (0x00, 0)
            assert max(abs(b - a) for a, b in pairwise(obeyed(drive))) <= 1000 * 20.0 * 0.01 + 1
        with can.Bus(interface="socketcan", channel=INTERFACE) as ear:
            assert not {each.arbitration_id for each in until_silent(ear)} & {frames.Cob.SYNC, RPDO, RPDO + 1}


async def test_a_second_source_of_sync_ends_the_sweep() -> None:
    async with bench(Drive(1), interface="socketcan", channel=INTERFACE, sync_period=0.01) as on:
        run = on.start(on.request(1, periods=300))
        await run_to_end(run, lambda _: on.cabinet.say(frames.Cob.SYNC))
        assert run.ending in (Ending.NOT_SENT, Ending.MISCOUNTED)
        assert run.joint == "joint_1"


def link(state: str) -> None:
    subprocess.run(["ip", "link", "set", INTERFACE, state], check=True)


async def test_an_interface_that_goes_down_is_lost_communication_and_nothing_is_sent_when_it_is_back() -> None:
    drive = Drive(1)
    async with bench(drive, interface="socketcan", channel=INTERFACE, sync_period=0.01) as on:
        run = on.start(on.request(1, periods=300))

        def pull(_: SampleBlock) -> None:
            link("down")

        try:
            with pytest.raises(CommunicationLost, match=r"bus vcan0: receiving failed|bus vcan0: sending failed"):
                await run_to_end(run, pull)
        finally:
            link("up")
        with pytest.raises(CommunicationLost):
            on.bus.send(frames.Cob.SYNC, b"")
        with can.Bus(interface="socketcan", channel=INTERFACE) as ear:
            assert ear.recv(0.5) is None


async def test_an_interface_that_is_not_there() -> None:
    with pytest.raises(CommunicationLost, match="vcan9: the kernel's CAN_BCM timer is not available"):
        KernelStream("vcan9", 0.01, plan, plan(0))
