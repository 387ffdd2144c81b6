"""STOP at every moment of what the drives can do: afterwards no axis has energy, and none gets any; nor after its end.

No service here: a drive port, the machine, and the stop sender of the stop process beside it. A snapshot every `PART` s
of each activity, a copy for each seed: it draws when in this part and by which way the stop comes, whether the host
stalls or other units are silent from then on, when each frame arrives, and which thread runs.
"""

import asyncio
import itertools
from collections.abc import Callable, Coroutine, Sequence
from contextlib import nullcontext, suppress
from dataclasses import replace
from functools import partial
from random import Random

import pytest

from drivers.contract.bench import Bench
from drivers.errors import DriveError
from drivers.ports import DrivePort, SweepMode
from tests.contract.bench import BENCHES
from tests.virtual_time.clock import Clock
from tests.virtual_time.explore import Explorer, Outcome
from tests.virtual_time.machine import VirtualMachine
from tests.virtual_time.modbus import Gateway
from tests.virtual_time.scheduler import drawn

AXIS = "joint_1"
BENCH: Bench = BENCHES["canopen-virtual"]
REACTION = 0.5  # s from a stop until no axis has energy: stop sequence of the host, ramps of the drives
LONGEST = 6.0  # s into an activity that a stop comes
PART, MOST = 0.3, 80  # s; parts of all activities
SEEDS = 16  # of each part: a hundred stops and more in each activity of five
ALONE = {"canopen": 1.0, "modbus": 0.05}  # s that a halt is alone; on Modbus it leaves 'quick stop active', with energy
SILENCE = 5.0  # s after it that nothing may get energy
STALL = (1e-3, 60.0)  # s


STOPPED: list[float] = []
"""When the port was told to stop: nobody enables an axis after that, which the gate of the service ensures."""


async def sweep(port: DrivePort, mode: SweepMode) -> None:
    await port.enable(AXIS)
    async for _ in port.run_sweep(await BENCH.sweep(port, mode, periods=2)):
        pass
    await port.disable(AXIS)


async def streamed(port: DrivePort) -> None:
    await sweep(port, SweepMode.HOST_STREAMED)


async def simultaneous(port: DrivePort) -> None:
    mode, both = SweepMode.HOST_STREAMED, (AXIS, "joint_2")
    await port.enable(*both)
    commands = [await replace(BENCH, axis=joint).sweep(port, mode) for joint in both]
    async for _ in port.run_sweep(*commands):
        pass
    for joint in both:
        await port.disable(joint)


async def drive_side(port: DrivePort) -> None:
    await sweep(port, SweepMode.DRIVE_SIDE)


async def moves(port: DrivePort) -> None:
    await port.enable(AXIS)
    await port.move_to(AXIS, 0.4, 0.3)
    await port.disable(AXIS)


async def enabling(port: DrivePort) -> None:
    for _ in range(20):
        if STOPPED:
            return
        await port.enable(AXIS)
        await port.disable(AXIS)


Activity = Callable[[DrivePort], Coroutine[object, object, None]]
ACTIVITIES: dict[str, tuple[Activity, ...]] = {
    "canopen": (streamed, simultaneous, drive_side, moves, enabling),
    "modbus": (drive_side, moves, enabling),
}


async def stopped(port: DrivePort, machine: VirtualMachine, clock: Clock, seed: int, only: Sequence[Activity]) -> str:
    """An activity from its beginning, and a stop. `only`: one of these."""
    chance = Random(f"stop {seed}")
    activity = chance.choice(only)
    doing = asyncio.create_task(activity(port), name=activity.__name__)
    return await pressed(port, machine, clock, chance, doing, LONGEST * chance.random() ** 2)


async def pressed(
    port: DrivePort,
    machine: VirtualMachine,
    clock: Clock,
    chance: Random,
    doing: "asyncio.Task[None]",
    moment: float,
) -> str:
    """One interleaving; what it was."""
    way = chance.choice(("stop", "halt, then stop", "another process, then stop"))
    stall = drawn(chance, STALL) if chance.random() < 0.3 else 0.0
    silent = {unit for unit in range(2, 7) if chance.random() < 0.5} if chance.random() < 0.3 else set[int]()
    sender = port.stop_sender()
    sender.open()
    await asyncio.sleep(moment)
    if doing.done():  # undisturbed
        assert doing.exception() is None, doing.exception()
        assert not machine.energised(), f"{machine.energised()} with energy after {doing.get_name()}"
    if stall:
        clock.suspend(clock.own, stall)
    if silent and isinstance(machine.wire, Gateway):
        way += f", units {silent} silent"
        machine.wire.lost = lambda adu, command: command and adu[6] in silent
    asked = clock.now
    sending = None
    if way.startswith("another"):  # a real one waits for silent units by itself
        sending = asyncio.create_task(asyncio.to_thread(sender.send), name="another process")
        await asyncio.sleep(chance.random() * 0.05)
    STOPPED.append(asked)
    if way.startswith("halt"):
        port.halt()
        await asyncio.sleep(chance.random() * ALONE[machine.fieldbus])
    with suppress(DriveError) if stall or "silent" in way else nullcontext():
        await port.stop()
    await asyncio.sleep(max(0.0, asked + REACTION - clock.now))
    (ended,) = await asyncio.gather(doing, return_exceptions=True)
    assert ended is None or isinstance(ended, DriveError), ended
    if sending is not None:
        await sending
    await asyncio.sleep(SILENCE)
    off = asked
    left: set[str] = set()
    what = f"{way} of {doing.get_name()}"
    for when, joint, on in machine.wire.cabinet.energy:
        if when <= asked + REACTION:
            left = left | {joint} if on else left - {joint}
            off = max(off, when)
        else:
            assert not on, f"{joint} got energy {when - asked:.3f} s after {what}"
    assert not left, f"{left} with energy {REACTION} s after {what}"
    sender.close()
    return f"{what}: {off - asked:.3f}"


async def connected(machine: VirtualMachine) -> DrivePort:
    port = machine.open()
    await port.connect()
    for joint in port.joints:
        await port.acknowledge(joint)
    return port


@pytest.mark.parametrize("machine", ["canopen", "modbus"], indirect=True)
async def test_a_stop_at_any_moment_leaves_no_energy(machine: VirtualMachine, clock: Clock, explore: Explorer) -> None:
    port = await connected(machine)
    outcomes: list[Outcome] = []
    parts = itertools.count()
    for activity in ACTIVITIES[machine.fieldbus]:
        doing = asyncio.create_task(activity(port), name=activity.__name__)

        async def step(seed: int, doing: "asyncio.Task[None]" = doing) -> str:
            chance = Random(f"stop {seed}")
            return await pressed(port, machine, clock, chance, doing, PART * chance.random())

        while not doing.done():
            here = partial(_in_part, next(parts))
            outcomes += (await explore.run(step, SEEDS * MOST, among=here)).outcomes
            await asyncio.sleep(PART)
        await doing
    assert next(parts) <= MOST
    print(f"{len(outcomes)} interleavings in {sum(outcome.cpu for outcome in outcomes):.1f} CPU s")
    await port.close()


def _in_part(part: int, seed: int) -> bool:
    return seed % MOST == part
