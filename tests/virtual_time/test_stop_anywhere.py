"""STOP at every moment of what the drives can do: afterwards no axis has energy, and none gets any.

No service here: a drive port, the machine, and the stop sender of the stop process beside it. One snapshot (connected),
one copy for each seed: the seed draws what moves, when and by which way the stop comes, whether the host stalls, when
each frame arrives, and which thread runs.
"""

import asyncio
from contextlib import nullcontext, suppress
from random import Random

from drivers.contract.bench import Bench
from drivers.errors import DriveError
from drivers.ports import DrivePort, SweepMode
from tests.contract.bench import BENCHES
from tests.virtual_time.clock import Clock
from tests.virtual_time.explore import Explorer
from tests.virtual_time.machine import VirtualMachine

AXIS = "joint_1"
BENCH: Bench = BENCHES["canopen-virtual"]
REACTION = 0.5  # s from a stop until no axis has energy: stop sequence of the host, ramps of the drives
LONGEST = 6.0  # s into an activity that a stop comes
SILENCE = 5.0  # s after it that nothing may get energy
STALL = (1e-3, 60.0)  # s


async def sweep(port: DrivePort, mode: SweepMode) -> None:
    await port.enable(AXIS)
    async for _ in port.run_sweep(await BENCH.sweep(port, mode, periods=2)):
        pass
    await port.disable(AXIS)


async def streamed(port: DrivePort) -> None:
    await sweep(port, SweepMode.HOST_STREAMED)


async def drive_side(port: DrivePort) -> None:
    await sweep(port, SweepMode.DRIVE_SIDE)


async def moves(port: DrivePort) -> None:
    await port.enable(AXIS)
    await port.move_to(AXIS, 0.4, 0.3)
    await port.disable(AXIS)


async def enabling(port: DrivePort) -> None:
    for _ in range(20):
        await port.enable(AXIS)
        await port.disable(AXIS)


ACTIVITIES = (streamed, drive_side, moves, enabling)


async def stopped(port: DrivePort, machine: VirtualMachine, clock: Clock, seed: int) -> str:
    """One interleaving; what it was."""
    chance = Random(f"stop {seed}")
    activity = chance.choice(ACTIVITIES)
    way = chance.choice(("stop", "halt, then stop", "another process, then stop"))
    moment = LONGEST * chance.random() ** 2
    low, high = STALL
    stall = low * (high / low) ** chance.random() if chance.random() < 0.3 else 0.0
    sender = port.stop_sender()
    sender.open()
    doing = asyncio.create_task(activity(port), name=activity.__name__)
    await asyncio.sleep(moment)
    if stall:
        clock.suspend(clock.own, stall)
    asked = clock.now
    if way != "stop":
        port.halt() if way == "halt, then stop" else sender.send()
        await asyncio.sleep(chance.random() * 0.05)
    with suppress(DriveError) if stall else nullcontext():
        await port.stop()
    await asyncio.sleep(max(0.0, asked + REACTION - clock.now))
    (ended,) = await asyncio.gather(doing, return_exceptions=True)
    assert ended is None or isinstance(ended, DriveError), ended
    await asyncio.sleep(SILENCE)
    off = asked
    left: set[str] = set()
    for when, joint, on in machine.wire.cabinet.energy:
        if when <= asked + REACTION:
            left = left | {joint} if on else left - {joint}
            off = max(off, when)
        else:
            assert not on, f"{joint} got energy {when - asked:.3f} s after {way} of {activity.__name__}"
    assert not left, f"{left} with energy {REACTION} s after {way} of {activity.__name__} at {moment:.3f} s"
    sender.close()
    return f"{activity.__name__}, {way}: {off - asked:.3f}"


async def connected(machine: VirtualMachine) -> DrivePort:
    port = machine.open()
    await port.connect()
    for joint in port.joints:
        await port.acknowledge(joint)
    return port


async def test_a_stop_at_any_moment_leaves_no_energy(machine: VirtualMachine, clock: Clock, explore: Explorer) -> None:
    port = await connected(machine)
    found = await explore.run(lambda seed: stopped(port, machine, clock, seed), 100, budget=60.0)
    print(f"{len(found.outcomes)} interleavings in {found.cpu:.1f} CPU s")
    await port.close()
