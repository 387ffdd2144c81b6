"""A stop on a Modbus line with silent units: the moving unit first, no request before all are told, a bounded wait."""

import asyncio
import math
import threading
import time
from collections.abc import Collection
from contextlib import suppress
from itertools import combinations
from typing import Any, cast

import pytest

from drivers.cia402 import states
from drivers.cia402.axis import Cia402Axis
from drivers.cia402.connection import DriveThread, capabilities
from drivers.cia402.host_watch import HostWatch
from drivers.cia402.machine import Cia402Machine
from drivers.cia402.states import Controlword
from drivers.errors import CommunicationLost, DriveError, StopNotConfirmed, SweepInterrupted
from drivers.modbus.device import ModbusDevice
from drivers.modbus.fieldbus import ModbusConnection, ModbusFieldbus
from drivers.modbus.line import MasterLine
from drivers.modbus.profile import RtuProfile, TcpProfile
from drivers.modbus.registers import RegisterMap
from tests.unit.drivers.modbus_bank import (
    HIGH,
    KINDS,
    LOW,
    Bank,
    Clock,
    Request,
    Wire,
    drive,
    following,
    nobody,
    profile_on,
    serving,
)

PROMISE = 0.2  # s from a stop to its write to the unit that moves
AXES, MOVING = 6, 4  # unit ids from 1
TIMEOUT = 2.0  # s
OTHERS = [unit for unit in range(1, AXES + 1) if unit != MOVING]
SILENT = [silent for number in range(len(OTHERS) + 1) for silent in combinations(OTHERS, number)]


def line_of(kind: str) -> TcpProfile | RtuProfile:
    if kind == "tcp":
        return TcpProfile(transport="tcp", host="127.0.0.1", timeout=TIMEOUT, watchdog=5.0)
    return RtuProfile(transport="rtu", device="memory", timeout=TIMEOUT, watchdog=5.0, silence_between_frames=0.01)


class Machine:
    """The units, of which one moves, and a thread that asks one after the other."""

    def __init__(self, kind: str, registers: RegisterMap) -> None:
        self.bank, self.clock = Bank(kind), Clock()
        self.wire = Wire(self.bank, self.clock)
        profile = profile_on(line_of(kind), kind, axes=AXES)
        for axis in profile.axes:
            drive(self.bank, registers, axis.unit_id, axis.rated_torque)
        following(self.bank, registers)
        self.line, self.thread = MasterLine(profile.line, self.clock, self.wire), DriveThread("test")
        control, watch = nobody(), HostWatch(60.0)
        self.devices = [ModbusDevice(axis, profile, registers, "", self.line, control) for axis in profile.axes]
        self.axes = {device.profile.joint: Cia402Axis(device, watch) for device in self.devices}
        self.line.open()
        identities = tuple(axis.introduce() for axis in self.axes.values())
        can = capabilities(self.axes.values())
        heart = cast("asyncio.Task[None]", None)  # the test is the only one that asks
        self.connection = ModbusConnection(
            self.thread, self.line, heart, self.devices, self.axes, identities, can, control
        )
        self.devices[MOVING - 1].allow_motion()
        self.controlword = registers.signals["controlword"].address

    async def asked(self, rounds: int) -> None:
        """Each unit, several times in one call, as a look at standing axes."""

        def ask() -> None:
            for device in self.devices * rounds:
                with suppress(CommunicationLost):
                    device.statusword()

        await self.thread.run(ask)

    async def stopped(self, silent: Collection[int], after: float) -> list[tuple[float, Request]]:
        """Requests since the stop, with the time after it."""
        self.wire.silent = silent
        when, begun = self.clock.now + after, list[int]()

        def stop() -> None:
            begun.append(len(self.wire.log))
            self.connection.halt(streaming=False)

        self.clock.at(when, stop)
        while not begun:
            await self.asked(3)
        await self.asked(1)
        await self.thread.close()
        return [(time - when, request) for time, request in self.wire.log[begun[0] :]]


@KINDS
@pytest.mark.parametrize("after", [0.0, 0.03, 0.4, 1.9, 2.5])
async def test_the_moving_unit_is_told_in_time_whoever_is_silent(
    kind: str, registers: RegisterMap, after: float
) -> None:
    worst = 0.0
    for silent in SILENT:
        machine = Machine(kind, registers)
        since = await machine.stopped(silent, after)
        stops = since[:AXES]
        assert all(
            request.function == 16 and request.address == machine.controlword and request.words[-1] == 2
            for _, request in stops
        ), f"{silent}: a request came before the last stop"
        assert stops[0][1].unit == MOVING
        assert {request.unit for _, request in stops} == set(range(1, AXES + 1))
        worst = max(worst, stops[0][0])
    assert worst <= PROMISE


@KINDS
async def test_a_second_stop_gives_a_silent_unit_no_more_time(kind: str, registers: RegisterMap) -> None:
    machine = Machine(kind, registers)
    for after in (0.15, 0.2, 0.24):
        machine.clock.at(machine.clock.now + after, lambda: machine.connection.halt(streaming=False))
    since = await machine.stopped({1}, 0.1)
    assert since[0][1].unit == MOVING
    assert since[0][0] <= PROMISE


@KINDS
async def test_after_a_stop_a_silent_unit_costs_a_short_time_out(kind: str, registers: RegisterMap) -> None:
    machine = Machine(kind, registers)
    since = await machine.stopped({1}, 0.1)
    reads = [(time, request.unit) for time, request in since if request.function == 3]
    first = next((time for time, unit in reads if unit == 1), None)
    if kind == "rtu":  # its late answer could be taken for another: it is lost
        assert first is None
    else:
        assert first is not None
        assert min(time for time, unit in reads if unit == 2 and time > first) - first <= 0.5 + 0.05


async def test_a_call_that_a_stop_interrupts_begins_again_after_it() -> None:
    machine = Machine("tcp", HIGH)
    machine.clock.at(machine.clock.now + 1e-3, lambda: machine.connection.halt(streaming=False))
    begun = len(machine.wire.log)
    status = await machine.thread.run(machine.axes["joint_1"].status)
    assert math.isfinite(status.position)
    kinds = [request.function for _, request in machine.wire.log[begun:]]
    assert kinds == [3, *[16] * AXES, 3, 3]
    await machine.thread.close()


@pytest.mark.parametrize("after", [k * 1e-3 for k in range(60)])
async def test_no_enabling_goes_on_after_the_stop_that_interrupted_it(after: float) -> None:
    """Whenever the stop comes: what stands in the drive at the end is no energy."""
    machine = Machine("tcp", HIGH)
    axis, stop = machine.axes["joint_1"], threading.Event()

    def halt() -> None:
        stop.set()
        machine.connection.halt(streaming=False)

    machine.clock.at(machine.clock.now + after, halt)
    with suppress(SweepInterrupted):
        await machine.thread.run(axis.enable, stop)
    machine.clock.sleep(0.1)
    await machine.thread.run(lambda: None)
    assert states.decode(machine.devices[0].statusword()) not in states.ENERGISED
    words = [r.words[-1] for _, r in machine.wire.log if r.function == 16 and r.address == machine.controlword]
    assert Controlword.QUICK_STOP in words
    told = len(words) - 1 - words[::-1].index(Controlword.QUICK_STOP)
    assert set(words[told:]) <= {Controlword.QUICK_STOP, Controlword.DISABLE_VOLTAGE}
    await machine.thread.close()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["tcp", "rtu"])
async def test_on_a_real_line_the_moving_unit_is_told_and_confirmed_before_the_silent_ones_time_out(kind: str) -> None:
    registers = HIGH if kind == "tcp" else LOW
    bank, told, asked = Bank(kind), threading.Event(), threading.Event()
    with serving(bank, TIMEOUT) as served:
        profile = profile_on(served.model_copy(update={"watchdog": 60.0}), kind, axes=3)
        for axis in profile.axes:
            drive(bank, registers, axis.unit_id, axis.rated_torque)
        following(bank, registers)
        machine = Cia402Machine(profile.axes, ModbusFieldbus(profile))
        await machine.connect()
        await machine.enable("joint_3")
        follow: Any = bank.react

        def react(request: Request) -> None:
            follow(request)
            if request.unit == 3 and request.words[-1] == Controlword.QUICK_STOP:
                told.set()

        def spoil(request: Request, frame: bytes) -> bytes | None:
            if request.unit == 3:
                return frame
            asked.set()
            return None

        bank.react, bank.spoil = react, spoil
        status = asyncio.create_task(machine.status())
        assert await asyncio.to_thread(asked.wait, 10)
        ordered = time.monotonic()
        machine.halt()
        assert await asyncio.to_thread(told.wait, 10)
        assert time.monotonic() - ordered < TIMEOUT / 4
        with pytest.raises(StopNotConfirmed) as refused:
            await machine.stop()
        assert set(refused.value.unconfirmed) == {"joint_1", "joint_2"}
        await status
        with suppress(DriveError):
            await machine.close()
