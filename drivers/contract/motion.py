"""Required behaviour of every `DrivePort` on every bus: connection, motion, sweeps, faults."""

import asyncio
import re
import time
from collections.abc import AsyncGenerator, Mapping
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

from drivers.contract.bench import Bench, MachineUnderTest, Suite, closing, column, consume, eventually, needs
from drivers.errors import (
    CommunicationLost,
    ConnectionFailed,
    DriveError,
    DriveFault,
    EmergencyStop,
    EnvelopeLeft,
    LimitExceeded,
    NotReady,
    SweepInterrupted,
    WrongIdentity,
)
from drivers.ports import AxisState, DrivePort, SampleBlock, SineCommand, SweepCommand, SweepMode

# interrupted at its beginning: 100 s of slow motion, 5 s of a machine at 20 times real time


def one_second(command: SweepCommand, bench: Bench) -> slice:
    """Samples of one second, from the start of the measured window."""
    first = round(command.measure_from * bench.rate(command.mode))
    return slice(first, first + round(bench.rate(command.mode)))


async def consume_rest(running: AsyncGenerator[SampleBlock, None]) -> None:
    async for _ in running:
        pass


class DrivePortSuite(Suite):
    """Connecting, moving, sweeps, and every way to end them."""

    async def test_connect_leaves_every_axis_disabled(self, port: DrivePort, virtual: MachineUnderTest) -> None:
        status = await port.status()
        assert tuple(status) == port.joints
        assert {axis.state for axis in status.values()} == {AxisState.DISABLED}
        assert virtual.energised() == []
        assert await port.faults() == ()
        assert port.capabilities.sweep_modes == virtual.bench.modes

    @needs(exclusive=False)
    async def test_connect_disables_what_a_dead_host_left_enabled(
        self, port: DrivePort, virtual: MachineUnderTest, axis: str
    ) -> None:
        await port.enable(axis)
        async with closing(virtual.open()) as second:
            await second.connect()
            assert virtual.energised() == []

    @needs(exclusive=True)
    async def test_a_second_host_is_refused_where_there_may_be_one(
        self, port: DrivePort, virtual: MachineUnderTest, axis: str
    ) -> None:
        await port.enable(axis)
        async with closing(virtual.open()) as second:
            with pytest.raises(ConnectionFailed):
                await second.connect()
            assert virtual.energised() == [axis]
            assert (await port.status())[axis].state is AxisState.ENABLED

    async def test_identity_is_reported(self, port: DrivePort) -> None:
        await port.close()
        identities = await port.connect()
        assert [identity.joint for identity in identities] == list(port.joints)
        assert len({identity.serial for identity in identities}) == len(identities)
        assert all(len(identity.dictionary_sha256) == 64 for identity in identities)
        await port.close()

    @needs(orders={"identity"})
    async def test_identity_is_checked(self, port: DrivePort, virtual: MachineUnderTest) -> None:
        await port.close()
        addresses = {identity.joint: identity.address for identity in await port.connect()}
        await port.close()
        other = virtual.bench.both[-1]
        (product,) = (
            axis["identity"]["product"] for axis in cast(Any, virtual.profile["axes"]) if axis["joint"] == other
        )
        virtual.order("identity", joint=other, product=0x9999)
        try:
            with pytest.raises(WrongIdentity, match=re.escape(f"{other} ({addresses[other]}): product is 00009999h")):
                await port.connect()
        finally:
            virtual.order("identity", joint=other, product=product)

    async def test_commands_before_connect_are_refused(self, virtual: MachineUnderTest, axis: str) -> None:
        port = virtual.open()
        with pytest.raises(NotReady):
            await port.enable(axis)
        await port.stop()
        await port.close()

    @needs(other=True)
    async def test_only_one_axis_is_enabled_at_a_time(
        self, port: DrivePort, virtual: MachineUnderTest, axis: str, other: str
    ) -> None:
        await port.enable(axis)
        assert (await port.status())[axis].state is AxisState.ENABLED
        with pytest.raises(NotReady, match=axis):
            await port.enable(other)
        assert virtual.energised() == [axis]
        await port.disable(axis)
        await port.enable(other)
        assert virtual.energised() == [other]

    async def test_move_arrives_at_standstill(self, port: DrivePort, virtual: MachineUnderTest, axis: str) -> None:
        await port.enable(axis)
        for target in (0.4, -0.2):
            await port.move_to(axis, target, 0.5)
            status = (await port.status())[axis]
            assert status.position == pytest.approx(target, abs=2e-3)
            assert virtual.truth(axis)["position"] == pytest.approx(target, abs=2e-3)
            assert status.velocity == pytest.approx(0.0, abs=1e-3)
            assert status.state is AxisState.ENABLED

    async def test_moves_outside_the_limits_are_refused_before_moving(
        self, port: DrivePort, virtual: MachineUnderTest, axis: str
    ) -> None:
        (low, high), fastest = virtual.bench.position_limits, virtual.bench.velocity_limit
        target = high + 0.54
        place = re.escape(f"{target:.5g} rad is outside {low:.5g} to {high:.5g} rad")
        speed = f"{7 * fastest:.4g} rad/s must be above 0 and at most {fastest:.4g} rad/s"
        await port.enable(axis)
        before = (await port.status())[axis].position
        with pytest.raises(LimitExceeded, match=place):
            await port.move_to(axis, target, 0.2)
        with pytest.raises(LimitExceeded, match=re.escape(speed)):
            await port.move_to(axis, 0.1, 7 * fastest)
        for position, velocity in ((float("nan"), 0.1), (0.1, float("nan")), (0.1, 0.0), (0.1, -0.1)):
            with pytest.raises(LimitExceeded):
                await port.move_to(axis, position, velocity)
        assert (await port.status())[axis].position == pytest.approx(before, abs=1e-4)

    async def test_motion_of_a_disabled_axis_is_refused(
        self, port: DrivePort, mode: SweepMode, virtual: MachineUnderTest, axis: str
    ) -> None:
        with pytest.raises(NotReady):
            await port.move_to(axis, 0.1, 0.1)
        with pytest.raises(NotReady):
            await consume(port, await virtual.bench.sweep(port, mode))

    @needs(missing=True)
    async def test_a_sweep_mode_that_the_drive_lacks_is_refused_before_moving(
        self, port: DrivePort, virtual: MachineUnderTest, mode: SweepMode, axis: str
    ) -> None:
        await port.enable(axis)
        before = virtual.truth(axis)["position"]
        with pytest.raises(NotReady, match=f"'{mode.value}'"):
            await consume(port, await virtual.bench.sweep(port, mode))
        assert virtual.truth(axis)["position"] == pytest.approx(before, abs=1e-4)
        assert (await port.status())[axis].state is AxisState.ENABLED

    async def test_sweep_delivers_consecutive_samples_of_what_was_commanded(
        self, port: DrivePort, mode: SweepMode, virtual: MachineUnderTest, axis: str
    ) -> None:
        await port.enable(axis)
        command = await virtual.bench.sweep(port, mode)
        before = (await port.status())[axis].position
        blocks = [block async for block in port.run_sweep(command)]
        index, when = column(blocks, "index"), column(blocks, "time")
        assert np.array_equal(index, np.arange(len(index)))
        assert np.allclose(when, index / virtual.bench.rate(mode))
        assert when[-1] == pytest.approx(command.duration, abs=0.01)
        assert all(block.joint == axis for block in blocks)
        assert len(blocks) > 1
        # set-point: zero at both ends, the command's lines inside the window
        velocity_setpoint = column(blocks, "velocity_setpoint")
        assert velocity_setpoint[0] == pytest.approx(0.0, abs=1e-4)
        window = one_second(command, virtual.bench)
        spectrum = np.fft.rfft(velocity_setpoint[window]) / virtual.bench.rate(mode)
        assert spectrum[0].real == pytest.approx(0.0105, rel=0.01)
        assert 2 * abs(spectrum[[2, 4]]) == pytest.approx([virtual.bench.amplitude] * 2, rel=0.01)
        # motion follows; position is the integral of velocity; friction opposes it
        velocity, position, effort = column(blocks, "velocity"), column(blocks, "position"), column(blocks, "effort")
        assert np.mean(velocity[window]) == pytest.approx(0.0105, rel=0.05)
        assert position[0] == pytest.approx(before, abs=1e-4)
        travelled = np.cumsum(velocity) / virtual.bench.rate(mode)
        assert np.abs(position - position[0] - travelled).max() < 2e-4
        low, high = virtual.bench.slow_effort
        assert low < np.mean(effort[window]) < high  # friction of the axis, positive in forward motion
        status = (await port.status())[axis]
        assert status.state is AxisState.ENABLED
        assert status.velocity == pytest.approx(0.0, abs=1e-3)

    @pytest.mark.parametrize(
        ("offset", "lines"),
        [(0.0, (1, 2, 3)), (0.0, ()), (-0.0105, (3, 5, 7, 11, 13, 17))],
        ids=["reversal", "hold", "wide"],
    )
    async def test_the_sweeps_of_a_diagnosis_run_as_commanded(
        self,
        port: DrivePort,
        mode: SweepMode,
        offset: float,
        lines: tuple[int, ...],
        virtual: MachineUnderTest,
        axis: str,
    ) -> None:
        """About standstill, holding still, and backwards with many lines; larger ones where the drive needs them."""
        amplitudes = [max(0.001, 2 * np.pi * line * virtual.bench.least_sine) for line in lines]
        sines = tuple(
            SineCommand(line, amplitude, 1.3 * line) for line, amplitude in zip(lines, amplitudes, strict=True)
        )
        await port.enable(axis)
        before = (await port.status())[axis].position
        command = await virtual.bench.sweep(port, mode, 1, offset_velocity=offset, sines=sines, period=1.0)
        blocks = [block async for block in port.run_sweep(command)]
        window = one_second(command, virtual.bench)
        wanted = np.zeros(20)
        wanted[list(lines)] = amplitudes
        spectrum = np.fft.rfft(column(blocks, "velocity_setpoint")[window]) / virtual.bench.rate(mode)
        assert spectrum[0].real == pytest.approx(offset, abs=2e-4)
        assert 2 * abs(spectrum[1:20]) == pytest.approx(wanted[1:], abs=4e-5)
        assert np.mean(column(blocks, "velocity")[window]) == pytest.approx(offset, abs=3e-4)
        way = offset * (command.duration - command.ramp)
        assert column(blocks, "position")[-1] - before == pytest.approx(way, abs=1e-3)
        assert (await port.status())[axis].state is AxisState.ENABLED

    @needs(modes={SweepMode.DRIVE_SIDE}, load_encoder=True)
    async def test_drive_side_sweep_brings_the_load_encoder(
        self, port: DrivePort, virtual: MachineUnderTest, axis: str
    ) -> None:
        await port.enable(axis)
        blocks = [block async for block in port.run_sweep(await virtual.bench.sweep(port, SweepMode.DRIVE_SIDE))]
        load = np.concatenate([block.load_position for block in blocks if block.load_position is not None])
        assert port.capabilities.load_encoder
        assert np.abs(load - column(blocks, "position")).max() < 2e-3

    async def test_all_modes_one_after_the_other_and_back(
        self, port: DrivePort, virtual: MachineUnderTest, axis: str
    ) -> None:
        await port.enable(axis)
        modes = sorted(virtual.bench.modes, key=lambda mode: mode.value)
        for mode in (*modes, *modes):
            blocks = [block async for block in port.run_sweep(await virtual.bench.sweep(port, mode, periods=1))]
            assert np.array_equal(column(blocks, "index"), np.arange(sum(len(block.index) for block in blocks)))
        await port.move_to(axis, 0.0, 0.5)

    async def test_sweeps_outside_the_limits_are_refused_before_moving(
        self, port: DrivePort, mode: SweepMode, virtual: MachineUnderTest, axis: str
    ) -> None:
        await port.enable(axis)
        here = (await port.status())[axis].position
        (low, high), fastest = virtual.bench.position_limits, virtual.bench.velocity_limit
        strongest = 1.8 * virtual.bench.effort
        bad: dict[str, Mapping[str, float | tuple[float, float]]] = {
            f"peak velocity {0.0105 + 2 * virtual.bench.amplitude:.4g} rad/s is beyond": {"velocity_limit": 0.012},
            "highest position": {"position_window": (here - 0.1, here + 0.001)},
            "start": {"position_window": (here + 0.1, here + 0.2)},
            f"velocity limit {3 * fastest:.4g} rad/s": {"velocity_limit": 3 * fastest},
            f"effort limit {strongest:.4g} N m": {"effort_limit": strongest},
            f"is outside {low:.5g} to {high:.5g} rad": {"position_window": (here - 0.1, high + 0.04)},
            "ramp": {"ramp": 0.0},
        }
        for message, change in bad.items():
            command = replace(await virtual.bench.sweep(port, mode), **change)
            with pytest.raises(LimitExceeded, match=message):
                await consume(port, command)
        status = (await port.status())[axis]
        assert status.position == pytest.approx(here, abs=1e-4)
        assert status.state is AxisState.ENABLED

    async def test_closing_a_sweep_early_leaves_the_axis_standing_and_disabled(
        self, port: DrivePort, virtual: MachineUnderTest, mode: SweepMode, axis: str
    ) -> None:
        await port.enable(axis)
        running = port.run_sweep(await virtual.bench.long_sweep(port, mode))
        first = await anext(running)
        assert first.index[0] == 0
        await running.aclose()
        assert virtual.energised() == []
        assert virtual.truth(axis)["velocity"] == pytest.approx(0.0, abs=1e-3)
        assert (await port.status())[axis].state is AxisState.DISABLED

    async def test_cancelling_a_sweep_leaves_the_axis_standing_and_disabled(
        self, port: DrivePort, virtual: MachineUnderTest, mode: SweepMode, axis: str
    ) -> None:
        await port.enable(axis)
        command = await virtual.bench.long_sweep(port, mode)
        moving = asyncio.Event()

        task = asyncio.create_task(consume(port, command, lambda _: moving.set()))
        await moving.wait()
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        await eventually(lambda: virtual.energised() == [])
        assert virtual.truth(axis)["velocity"] == pytest.approx(0.0, abs=1e-3)

    async def test_stop_from_another_task_and_twice(
        self, port: DrivePort, virtual: MachineUnderTest, mode: SweepMode, axis: str
    ) -> None:
        await port.enable(axis)
        blocks: list[SampleBlock] = []
        moving = asyncio.Event()

        def keep(block: SampleBlock) -> None:
            blocks.append(block)
            moving.set()

        task = asyncio.create_task(consume(port, await virtual.bench.long_sweep(port, mode), keep))
        await moving.wait()
        await asyncio.gather(port.stop(), port.stop())
        assert virtual.energised() == []
        with pytest.raises(SweepInterrupted):
            await task
        index = column(blocks, "index")
        assert np.array_equal(index, np.arange(len(index)))
        await port.stop()
        assert (await port.status())[axis].state is AxisState.DISABLED
        await port.enable(axis)  # a stop is no fault

    async def test_stop_reaches_a_sweep_whose_consumer_hangs(
        self, port: DrivePort, virtual: MachineUnderTest, mode: SweepMode, axis: str
    ) -> None:
        await port.enable(axis)
        running = port.run_sweep(await virtual.bench.long_sweep(port, mode))
        await anext(running)
        await port.stop()
        assert virtual.energised() == []
        await running.aclose()
        await port.enable(axis)

    async def test_cancelling_connect_or_enable_leaves_nothing_behind(
        self, virtual: MachineUnderTest, axis: str
    ) -> None:
        for steps in range(1, 30, 4):  # cancelled at different places
            async with closing(virtual.open()) as port:
                task = asyncio.create_task(port.connect())
                for _ in range(steps):
                    await asyncio.sleep(0)
                if task.cancel():  # on a busy computer it may have connected by now
                    with pytest.raises(asyncio.CancelledError):
                        await task
        async with closing(virtual.open()) as port:
            await port.connect()
            for joint in port.joints:
                await port.acknowledge(joint)
            task = asyncio.ensure_future(port.enable(axis))
            await asyncio.sleep(0)  # it runs up to its first exchange with the drive
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
            assert virtual.energised() == []

    async def test_stop_during_a_move(self, port: DrivePort, virtual: MachineUnderTest, axis: str) -> None:
        await port.enable(axis)
        await port.move_to(axis, 0.0, 1.0)
        task = asyncio.create_task(port.move_to(axis, 2.0, 0.01))  # 10 s at 20 times real time
        await eventually(lambda: virtual.truth(axis)["velocity"] > 0.005)
        await port.stop()
        with pytest.raises(SweepInterrupted):
            await task
        assert virtual.energised() == []
        assert 0.0 < (await port.status())[axis].position < 1.9
        assert (await port.status())[axis].velocity == pytest.approx(0.0, abs=1e-3)

    async def test_a_second_motion_is_refused_while_one_runs(
        self, port: DrivePort, mode: SweepMode, virtual: MachineUnderTest, axis: str
    ) -> None:
        await port.enable(axis)
        running = port.run_sweep(await virtual.bench.long_sweep(port, mode))
        await anext(running)
        with pytest.raises(NotReady, match="one motion at a time"):
            await port.move_to(axis, 0.0, 0.1)
        for other in virtual.bench.both[1:]:
            with pytest.raises(NotReady):
                await port.enable(other)
        await running.aclose()

    async def test_close_in_the_middle_of_a_sweep(self, virtual: MachineUnderTest, mode: SweepMode, axis: str) -> None:
        async with closing(virtual.open()) as port:
            await port.connect()
            for joint in port.joints:
                await port.acknowledge(joint)
            await port.enable(axis)
            running = port.run_sweep(await virtual.bench.long_sweep(port, mode))
            await anext(running)
        assert virtual.energised() == []
        with pytest.raises(SweepInterrupted):
            await consume_rest(running)
        with pytest.raises(NotReady, match="not connected"):
            await port.status()


class NoiseSuite(Suite):
    async def test_the_capability_is_reported(self, port: DrivePort, virtual: MachineUnderTest) -> None:
        assert port.capabilities.torque_injection is virtual.bench.injects

    @needs(injects=False)
    async def test_noise_is_refused_before_moving_where_there_is_none(
        self, port: DrivePort, virtual: MachineUnderTest, axis: str
    ) -> None:
        await port.enable(axis)
        before = virtual.truth(axis)["position"]
        with pytest.raises(NotReady, match="torque noise is not supported by this drive"):
            await consume(port, await virtual.bench.noise(port))
        assert virtual.truth(axis)["position"] == pytest.approx(before, abs=1e-4)
        assert (await port.status())[axis].state is AxisState.ENABLED


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
        assert index[0] == 0
        # a jump is a lost sample: of a drive that does not count its samples a busy computer may lose some
        assert set(np.diff(index)) == {1} if counts else np.all(np.diff(index) > 0)
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
