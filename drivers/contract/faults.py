"""Required behaviour of every `DrivePort` on errors of the drive, the bus or the axis."""

import asyncio
import time

import numpy as np
import pytest

from drivers.contract.bench import MachineUnderTest, Suite, column, consume, eventually, needs
from drivers.errors import CommunicationLost, DriveError, DriveFault, EmergencyStop, EnvelopeLeft
from drivers.ports import AxisState, DrivePort, SampleBlock, SweepMode

# interrupted in motion: 100 s of slow motion, 5 s of a machine at 20 times real time


class FaultSuite(Suite):
    """Faults, emergency stop, silence and lost samples, as far as they can be injected."""

    @needs(orders={"fault"})
    async def test_fault_in_a_sweep_delivers_what_there_is_and_waits_for_a_person(
        self, port: DrivePort, virtual: MachineUnderTest, mode: SweepMode, axis: str
    ) -> None:
        await port.enable(axis)
        blocks: list[SampleBlock] = []
        counts = "freeze_counter" in virtual.bench.orders or mode is SweepMode.DRIVE_SIDE
        if counts:
            place = {"at_sample": 200} if mode is SweepMode.DRIVE_SIDE else {"at_counter": _counter(virtual) + 200}
            virtual.order("fault", joint=axis, code=0x7305, **place)

        def each(block: SampleBlock) -> None:
            blocks.append(block)
            if not counts and block.index[0] < 200 <= block.index[-1]:
                virtual.order("fault", joint=axis, code=0x7305)

        with pytest.raises(DriveFault, match="7305h"):
            await consume(port, await virtual.bench.long_sweep(port, mode), each)
        index = column(blocks, "index")
        assert np.array_equal(index, np.arange(len(index)))
        # of 25000; on a busy computer the last ones are late answers to SYNC
        assert 190 <= len(index) <= 500
        # de-energised, reported, and cleared only by an acknowledgement
        assert virtual.energised() == []
        assert (await port.status())[axis].state is AxisState.FAULT
        (fault,) = await port.faults()
        assert (fault.joint, fault.code, fault.emergency_stop) == (axis, 0x7305, False)
        for joint in virtual.bench.both:
            with pytest.raises(DriveError):
                await port.enable(joint)
        await port.acknowledge(axis)
        assert virtual.energised() == []
        assert (await port.status())[axis].state is AxisState.DISABLED
        assert await port.faults() == ()
        await port.enable(axis)

    @needs(orders={"fault"})
    async def test_fault_at_rest_is_seen_and_kept(self, port: DrivePort, virtual: MachineUnderTest, axis: str) -> None:
        other = virtual.bench.both[-1]
        virtual.order("fault", joint=other, code=0x4310)
        await eventually(lambda: virtual.truth(other)["fault"] == 0x4310)
        assert [(fault.joint, fault.code) for fault in await port.faults()] == [(other, 0x4310)]
        with pytest.raises(DriveFault, match="4310h"):
            await port.enable(axis)
        await port.acknowledge(other)
        await port.enable(axis)

    @needs(orders={"emergency_stop"})
    async def test_emergency_stop_in_a_sweep(
        self, port: DrivePort, virtual: MachineUnderTest, mode: SweepMode, axis: str
    ) -> None:
        await port.enable(axis)
        with pytest.raises(EmergencyStop):
            await consume(
                port, await virtual.bench.long_sweep(port, mode), lambda _: virtual.order("emergency_stop", on=True)
            )
        assert virtual.energised() == []
        assert {fault.emergency_stop for fault in await port.faults()} == {True}
        with pytest.raises(DriveFault, match="while its cause persists"):
            await port.acknowledge(axis)
        virtual.order("emergency_stop", on=False)
        with pytest.raises(EmergencyStop):
            await port.enable(axis)
        for joint in port.joints:
            await port.acknowledge(joint)
        assert virtual.energised() == []
        await port.enable(axis)

    async def test_envelope_left_while_moving_stops_the_axis(
        self, port: DrivePort, virtual: MachineUnderTest, mode: SweepMode, axis: str
    ) -> None:
        await port.enable(axis)
        # by the host or by the drive's own limit, whichever comes first
        with pytest.raises((EnvelopeLeft, DriveFault)):
            await consume(port, await virtual.bench.long_sweep(port, mode, effort_limit=virtual.bench.least_effort))
        assert virtual.energised() == []

    @needs(orders={"silence"})
    async def test_a_node_that_falls_silent_is_lost_communication(
        self, port: DrivePort, virtual: MachineUnderTest, mode: SweepMode, axis: str
    ) -> None:
        await port.enable(axis)
        with pytest.raises(CommunicationLost):
            await consume(
                port,
                await virtual.bench.long_sweep(port, mode),
                lambda _: virtual.order("silence", joint=axis, on=True),
            )
        assert (await port.status())[axis].state is AxisState.UNKNOWN
        # on a busy computer a late answer is requested again
        deadline = time.monotonic() + 20
        for other in virtual.bench.both[1:]:
            while (await port.status())[other].state is not AxisState.DISABLED:
                assert time.monotonic() < deadline, "a silent node took the other one with it"
                await asyncio.sleep(0.1)
        # the drive receives but cannot answer; its own watchdogs also stop it
        await eventually(lambda: virtual.energised() == [])
        virtual.order("silence", joint=axis, on=False)

    @needs(modes={SweepMode.HOST_STREAMED}, orders={"drop_tpdos"})
    async def test_a_lost_sample_shows_as_a_jump_of_the_index(
        self, port: DrivePort, virtual: MachineUnderTest, axis: str
    ) -> None:
        await port.enable(axis)
        blocks: list[SampleBlock] = []
        async for block in port.run_sweep(await virtual.bench.sweep(port, SweepMode.HOST_STREAMED, periods=10)):
            if not blocks:
                virtual.order("drop_tpdos", joint=axis, count=1)
            blocks.append(block)
        index = column(blocks, "index")
        assert sorted(np.unique(np.diff(index))) == [1, 2]
        assert np.count_nonzero(np.diff(index) == 2) == 1
        assert np.allclose(column(blocks, "time"), index * virtual.bench.sync_period)

    @needs(modes={SweepMode.HOST_STREAMED}, orders={"freeze_counter"})
    async def test_a_sample_counter_that_stands_still_ends_the_sweep(
        self, port: DrivePort, virtual: MachineUnderTest, axis: str
    ) -> None:
        await port.enable(axis)
        with pytest.raises(CommunicationLost, match="no sample"):
            await consume(
                port,
                await virtual.bench.long_sweep(port, SweepMode.HOST_STREAMED),
                lambda _: virtual.order("freeze_counter", joint=axis, on=True),
            )
        assert virtual.energised() == []


def _counter(virtual: MachineUnderTest) -> int:
    counter: int = virtual.order("status")["sync_counter"]
    return counter
