"""Whatever goes wrong with a sweep: it fails with its cause, the samples so far are kept, and a person has to act."""

import asyncio
import dataclasses
import math
import os
import re
from collections.abc import Callable
from typing import NamedTuple

import pytest

from drivers.errors import CommunicationLost, DriveFault
from drivers.ports import SampleBlock, SweepCommand
from service.model.errors import EnvelopeViolation, NotFound
from service.store.documents import CampaignState, RecordingState, SweepState
from service.store.files.columns import read_columns
from tests.unit.service.campaigns.conftest import RAMP, SETTLE, Bench

pytestmark = pytest.mark.slow

STEP = math.radians(0.5) / 20  # of the drives that do not do as they are told, every few milliseconds
WHOLE = round((5 * 1.0 + RAMP + SETTLE + RAMP) * 250)  # samples of a sweep
Make = Callable[[Bench, pytest.MonkeyPatch], None]


class Case(NamedTuple):
    """`cause`: a pattern. `kept`: samples of the partial recording, None: there is none. `moves`: some axis does."""

    make: Make
    cause: str
    kept: int | None = None
    sweep: int = 1
    moves: bool = True


def fails(block: int, error: Exception) -> Make:
    def make(bench: Bench, patch: pytest.MonkeyPatch) -> None:
        patch.setattr(bench.drive, "fail", {block: error})

    return make


def lost_sample(bench: Bench, patch: pytest.MonkeyPatch) -> None:
    patch.setattr(bench.drive, "skip", 600)


def measured(change: Callable[[SampleBlock], None]) -> Make:
    """Other samples than the formula's."""

    def make(bench: Bench, patch: pytest.MonkeyPatch) -> None:
        samples = bench.drive.samples

        def changed(command: SweepCommand) -> SampleBlock:
            block = samples(command)
            change(block)
            return block

        patch.setattr(bench.drive, "samples", changed)

    return make


def jolt(block: SampleBlock) -> None:
    block.effort[700] = 1300.0


def reversed_effort(block: SampleBlock) -> None:
    block.effort[:] = -block.effort


def commanded(make: Make = lambda _bench, _patch: None, **change: float) -> Make:
    """Other commands than the plan's."""

    def both(bench: Bench, patch: pytest.MonkeyPatch) -> None:
        compile_plan = bench.compile_plan

        def changed(campaign):
            compiled = compile_plan(campaign)
            commands = {n: dataclasses.replace(c, **change) for n, c in compiled.commands.items()}
            return dataclasses.replace(compiled, commands=commands)

        patch.setattr(bench, "compile_plan", changed)
        make(bench, patch)

    return both


def short(bench: Bench, patch: pytest.MonkeyPatch) -> None:
    move_to = bench.drive.move_to

    async def moved(joint: str, position: float, velocity: float) -> None:
        await move_to(joint, position * 0.9, velocity)

    patch.setattr(bench.drive, "move_to", moved)


def slips(bench: Bench, patch: pytest.MonkeyPatch) -> None:
    """Another axis, while this one is swept."""
    run_sweep = bench.drive.run_sweep

    async def sweep(*commands: SweepCommand):
        async for block in run_sweep(*commands):
            patch.setitem(bench.drive.position, "joint_2", 0.01)
            yield block

    patch.setattr(bench.drive, "run_sweep", sweep)


def check_move(towards: Callable[[Bench, str, float], bool], error: Exception | None = None) -> Make:
    """`towards` moves a little, and tells whether it goes on; it is a task until then."""

    def make(bench: Bench, patch: pytest.MonkeyPatch) -> None:
        async def moved(joint: str, position: float, velocity: float) -> None:
            if error is not None:
                raise error
            while towards(bench, joint, position):  # noqa: ASYNC110
                await asyncio.sleep(0.005)

        patch.setattr(bench.drive, "position", dict(bench.drive.position))
        patch.setattr(bench.drive, "move_to", moved)

    return make


def away(bench: Bench, joint: str, _position: float) -> bool:
    bench.drive.position[joint] -= STEP
    return True  # until it is stopped


def coupled(bench: Bench, joint: str, position: float) -> bool:
    bench.drive.position[joint] += STEP
    bench.drive.position["joint_3"] += STEP / 2
    return bench.drive.position[joint] < position


def stuck(_bench: Bench, _joint: str, _position: float) -> bool:
    return False


def no_room(bench: Bench, patch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise EnvelopeViolation("no room")

    patch.setattr(bench.compile_plan(bench.campaign).envelope, "check_move", refuse)


def full_disk(bench: Bench, patch: pytest.MonkeyPatch) -> None:
    """It takes all but the last block."""
    written, sync = list[int](), os.fsync

    def refuse(file: int) -> None:
        written.append(file)
        if len(written) == 7:
            raise OSError(28, "No space left on device")
        sync(file)

    patch.setattr("service.store.files.columns.os.fsync", refuse)


FAR = "distance from the planned pose {} rad is above the limit 0.002 rad"
CASES = {
    "drive fault": Case(fails(3, DriveFault("joint_1: 0x2310")), "^DriveFault: joint_1: 0x2310$", 750),
    "lost connection": Case(fails(1, CommunicationLost("bus-off")), "^CommunicationLost: bus-off$", 250),
    "lost sample": Case(lost_sample, "^SamplesMissing: joint_1: sample 601 received instead of 600$", 500),
    "effort outside": Case(
        commanded(measured(jolt), effort_limit=1200.0), "^EnvelopeViolation: joint_1: effort 1300 N m is outside", 750
    ),
    "command outside": Case(commanded(velocity_limit=9.0), "velocity limit 9 rad/s is above the limit", moves=False),
    "implausible": Case(measured(reversed_effort), "^ImplausibleChannels: joint_1: apparent inertia -", WHOLE),
    "stands elsewhere": Case(short, f"joint_1: {FAR.format('0.04')}", sweep=2),
    "another axis slips": Case(slips, f"joint_2: {FAR.format('0.01')}", WHOLE),
    "full disk": Case(full_disk, r"^OSError: \[Errno 28\] No space left on device", WHOLE),
    "check move: no room": Case(no_room, "no room", moves=False),
    "check move: wrong way": Case(check_move(away), "^CheckMoveFailed: joint_1: moved by -"),
    "check move: another axis too": Case(check_move(coupled), r"^CheckMoveFailed: joint_3: moved by \+"),
    "check move: stuck": Case(check_move(stuck), "target not reached; limit"),
    "check move: fault": Case(check_move(stuck, DriveFault("joint_1: 0x8611")), "^DriveFault: joint_1: 0x8611$"),
}


@pytest.mark.parametrize("name", CASES)
async def test_trouble_ends_the_sweep_and_waits_for_a_person(bench: Bench, name: str) -> None:
    case = CASES[name]
    with pytest.MonkeyPatch.context() as patch:
        case.make(bench, patch)
        await bench.start()
        campaign = await bench.over()
        sweep = bench.store.sweep(campaign.id, case.sweep)
        assert sweep.state is SweepState.FAILED
        assert re.search(case.cause, sweep.cause), sweep.cause
        assert (campaign.state, campaign.cause) == (CampaignState.PAUSED, sweep.cause)
        assert campaign.sweeps[SweepState.PLANNED] == 4 - case.sweep
        assert bench.drive.trace[-1] == "stop"
        enabled = [entry for entry in bench.drive.trace if entry.startswith("enable")]
        assert bool(enabled) is case.moves
        if name.startswith("check move"):
            assert enabled in ([], ["enable joint_1"])
            assert not any(entry.startswith("sweep") for entry in bench.drive.trace)
            assert bench.drive.position["joint_2"] == 0.0
        if case.kept is None:
            with pytest.raises(NotFound):
                bench.store.recording(campaign.id, case.sweep)
        else:
            partial = bench.store.recording(campaign.id, case.sweep)
            recording = read_columns(bench.files.path(partial))
            assert (partial.state, partial.samples, len(recording.time)) == (
                RecordingState.PARTIAL, case.kept, case.kept
            )  # fmt: skip
            assert (recording.effort.max() == 1300.0) == (name == "effort outside")  # what ended it is kept
        assert bench.files.streams() == {}
        if name == "lost connection":
            assert (bench.machine.connected, bench.machine.trouble) == (False, "bus-off")

    await bench.resume()  # a failed sweep is repeated only on command
    assert (await bench.over()).sweeps == {SweepState.FAILED: 1, SweepState.RECORDED: 3}
