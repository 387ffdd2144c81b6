"""Trouble of an axis that stands beside a sweep ends it, also while nobody takes its samples."""

import threading

import pytest

from drivers.cia402.axis import Axis
from drivers.cia402.host_watch import HostWatch
from drivers.cia402.idle_axes import Watched
from drivers.cia402.thread import DriveThread
from drivers.errors import CommunicationLost, DriveFault, SweepInterrupted
from tests.unit.drivers.given import sweep
from tests.unit.drivers.small_servo import Servo, connected, eventually

COMMAND = sweep(periods=1000)


async def test_a_drive_side_sweep_ends_while_its_consumer_hangs() -> None:
    moving, standing = Servo("joint_1", samples_a_look=5), Servo("joint_2")
    async with connected(moving, standing) as (port, _):
        await port.enable("joint_1")
        run = port.run_sweep(COMMAND)
        await anext(run)
        standing.announced = 0x4310
        await eventually(lambda: not moving.energised)
        with pytest.raises(DriveFault, match=r"joint_2 \(small\): error 4310h"):
            async for _ in run:
                pass


async def test_a_stop_by_a_person_stays_a_stop() -> None:
    moving, standing = Servo("joint_1", samples_a_look=5), Servo("joint_2")
    async with connected(moving, standing) as (port, _):
        await port.enable("joint_1")
        run = port.run_sweep(COMMAND)
        await anext(run)
        await port.stop()
        standing.announced = 0x4310
        with pytest.raises(SweepInterrupted, match="sweep was stopped"):
            async for _ in run:
                pass


async def test_the_end_of_the_moving_axis_is_told_before_that_of_one_that_stands() -> None:
    standing, stop = Servo("joint_2", announced=0x4310), threading.Event()
    thread, axis = DriveThread("test"), Axis(standing, HostWatch(60.0))

    async def lose() -> None:
        async with Watched(thread, [axis], stop):
            await eventually(stop.is_set)
            raise CommunicationLost("the cable")

    with pytest.raises(CommunicationLost, match="the cable"):
        await lose()
    await thread.close()
