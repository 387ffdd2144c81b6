"""What every `DrivePort` must do when the drive, the bus or the axis misbehaves."""

import asyncio
import time

import numpy as np
import pytest

from drivers.errors import (
    CommunicationLost,
    DriveError,
    DriveFault,
    EmergencyStop,
    EnvelopeLeft,
)
from drivers.ports import AxisState, DrivePort, SampleBlock, SweepMode
from tests.contract.bench import AXIS, OTHER, SYNC_PERIOD, Virtual, column, consume, eventually, sweep

# interrupted on its way: 100 s of a slow turn, 5 s of a machine at 20 times real time
LONG: dict[str, object] = {"periods": 200, "offset_velocity": 0.0045}


async def test_fault_in_a_sweep_delivers_what_there_is_and_waits_for_a_person(
    port: DrivePort, virtual: Virtual, mode: SweepMode
) -> None:
    await port.enable(AXIS)
    blocks: list[SampleBlock] = []
    counts = "freeze_counter" in virtual.bench.orders or mode is SweepMode.DRIVE_SIDE
    if counts:
        place = {"at_sample": 200} if mode is SweepMode.DRIVE_SIDE else {"at_counter": _counter(virtual) + 200}
        virtual.order("fault", joint=AXIS, code=0x7305, **place)

    def each(block: SampleBlock) -> None:
        blocks.append(block)
        if not counts and block.index[0] < 200 <= block.index[-1]:
            virtual.order("fault", joint=AXIS, code=0x7305)

    with pytest.raises(DriveFault, match="7305h"):
        await consume(port, await sweep(port, mode, **LONG), each)
    index = column(blocks, "index")
    assert np.array_equal(index, np.arange(len(index)))
    assert 190 <= len(index) <= 500  # of 25000; the last of a busy machine are its answers to SYNCs that had to wait
    # de-energised, told, and nothing but an acknowledgement helps
    assert virtual.energised() == []
    assert (await port.status())[AXIS].state is AxisState.FAULT
    (fault,) = await port.faults()
    assert (fault.joint, fault.code, fault.emergency_stop) == (AXIS, 0x7305, False)
    for joint in (AXIS, OTHER):
        with pytest.raises(DriveError):
            await port.enable(joint)
    await port.acknowledge(AXIS)
    assert virtual.energised() == []
    assert (await port.status())[AXIS].state is AxisState.DISABLED
    assert await port.faults() == ()
    await port.enable(AXIS)


async def test_fault_at_rest_is_seen_and_kept(port: DrivePort, virtual: Virtual) -> None:
    virtual.order("fault", joint=OTHER, code=0x4310)
    await eventually(lambda: virtual.truth(OTHER)["fault"] == 0x4310)
    assert [(fault.joint, fault.code) for fault in await port.faults()] == [(OTHER, 0x4310)]
    with pytest.raises(DriveFault, match="4310h"):
        await port.enable(AXIS)
    await port.acknowledge(OTHER)
    await port.enable(AXIS)


async def test_emergency_stop_in_a_sweep(port: DrivePort, virtual: Virtual, mode: SweepMode) -> None:
    await port.enable(AXIS)
    with pytest.raises(EmergencyStop):
        await consume(port, await sweep(port, mode, **LONG), lambda _: virtual.order("emergency_stop", on=True))
    assert virtual.energised() == []
    assert {fault.emergency_stop for fault in await port.faults()} == {True}
    with pytest.raises(DriveFault, match="while its cause is there"):
        await port.acknowledge(AXIS)
    virtual.order("emergency_stop", on=False)
    with pytest.raises(EmergencyStop):
        await port.enable(AXIS)
    for joint in port.joints:
        await port.acknowledge(joint)
    assert virtual.energised() == []
    await port.enable(AXIS)


async def test_envelope_left_while_moving_stops_the_axis(port: DrivePort, virtual: Virtual, mode: SweepMode) -> None:
    await port.enable(AXIS)
    with pytest.raises((EnvelopeLeft, DriveFault)):  # by the host or by the drive's own limit, whichever comes first
        await consume(port, await sweep(port, mode, effort_limit=100.0, **LONG))
    assert virtual.energised() == []


@pytest.mark.orders("silence")
async def test_a_node_that_falls_silent_is_lost_communication(
    port: DrivePort, virtual: Virtual, mode: SweepMode
) -> None:
    await port.enable(AXIS)
    with pytest.raises(CommunicationLost):
        await consume(port, await sweep(port, mode, **LONG), lambda _: virtual.order("silence", joint=AXIS, on=True))
    assert (await port.status())[AXIS].state is AxisState.UNKNOWN
    # one that did not answer in time, on a busy computer, is asked again
    deadline = time.monotonic() + 20
    while (await port.status())[OTHER].state is not AxisState.DISABLED:
        assert time.monotonic() < deadline, "a silent node took the other one with it"
        await asyncio.sleep(0.1)
    # the drive hears what it cannot answer, and its own watchdogs hold as well
    await eventually(lambda: virtual.energised() == [])
    virtual.order("silence", joint=AXIS, on=False)


@pytest.mark.has(SweepMode.HOST_STREAMED)
@pytest.mark.orders("drop_tpdos")
async def test_a_lost_sample_shows_as_a_jump_of_the_index(port: DrivePort, virtual: Virtual) -> None:
    await port.enable(AXIS)
    blocks: list[SampleBlock] = []
    async for block in port.run_sweep(await sweep(port, SweepMode.HOST_STREAMED, periods=10)):
        if not blocks:
            virtual.order("drop_tpdos", joint=AXIS, count=1)
        blocks.append(block)
    index = column(blocks, "index")
    assert sorted(np.unique(np.diff(index))) == [1, 2]
    assert np.count_nonzero(np.diff(index) == 2) == 1
    assert np.allclose(column(blocks, "time"), index * SYNC_PERIOD)


@pytest.mark.has(SweepMode.HOST_STREAMED)
@pytest.mark.orders("freeze_counter")
async def test_a_sample_counter_that_stands_still_ends_the_sweep(port: DrivePort, virtual: Virtual) -> None:
    await port.enable(AXIS)
    with pytest.raises(CommunicationLost, match="no sample"):
        await consume(
            port,
            await sweep(port, SweepMode.HOST_STREAMED, **LONG),
            lambda _: virtual.order("freeze_counter", joint=AXIS, on=True),
        )
    assert virtual.energised() == []


def _counter(virtual: Virtual) -> int:
    counter: int = virtual.order("status")["sync_counter"]
    return counter
