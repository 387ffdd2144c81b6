"""What is watched beside a sweep: the check move before it, and the sign of life of a person."""

import asyncio
import math

import pytest

from drivers.errors import CommunicationLost, DriveFault
from drivers.ports import AxisState, AxisStatus
from service import Conflict
from service.machine.execution.check_move import CheckMove, CheckMoveFailed
from service.store.documents import CampaignDocument, CampaignState, EventKind
from tests.unit.service.campaigns.conftest import Barrier, Bench, until, until_cancelled
from tests.unit.service.campaigns.test_machine import between_motions  # noqa: F401

WAY = math.radians(0.5)


UNITS = {"joint_1": "rad", "joint_2": "rad", "slide": "m"}


START = {"joint_1": 0.3, "joint_2": -0.1, "slide": 0.5}


def status(**moved: float) -> dict[str, AxisStatus]:
    return {
        joint: AxisStatus(joint, AxisState.ENABLED, start + moved.get(joint, 0.0), 0.0, 0.0, None)
        for joint, start in START.items()
    }


@pytest.mark.parametrize("way", [WAY, -WAY])
def test_an_axis_that_does_as_it_is_told_passes(way: float) -> None:
    move = CheckMove("joint_1", way, START, UNITS)
    assert move.target == START["joint_1"] + way
    for share in (-0.05, 0.0, 0.5, 1.0, 1.2):
        move.check_under_way(status(joint_1=share * way, joint_2=5e-4, slide=1e-4))
    for share in (0.8, 1.0, 1.2):
        move.check_end(status(joint_1=share * way))


@pytest.mark.parametrize("way", [WAY, -WAY])
@pytest.mark.parametrize(
    ("share", "others", "message"),
    [
        (-0.15, {}, "joint_1: moved by .* rad in its check move of .* rad: wrong direction; limit .* rad"),
        (1.3, {}, "joint_1: moved by .* rad in its check move of .* rad: limit .* rad"),
        (0.5, {"joint_2": 1e-3}, r"joint_2: moved by \+0.001 rad in the check move of joint_1, limit 0.00087 rad"),
        (0.5, {"slide": -3e-4}, r"slide: moved by -0.0003 m in the check move of joint_1, limit 0.0002 m"),
        (math.nan, {}, "wrong direction"),
    ],
)
def test_what_goes_astray_is_told_with_value_and_limit(way: float, share: float, others: dict, message: str) -> None:
    move = CheckMove("joint_1", way, START, UNITS)
    with pytest.raises(CheckMoveFailed, match=message):
        move.check_under_way(status(joint_1=share * way, **others))


def test_who_does_not_arrive_or_answer_is_told() -> None:
    move = CheckMove("joint_1", WAY, START, UNITS)
    with pytest.raises(CheckMoveFailed, match=r"target not reached; limit \+0\.00654 rad"):
        move.check_end(status(joint_1=0.7 * WAY))
    silent = AxisStatus("joint_2", AxisState.UNKNOWN, math.nan, math.nan, math.nan, None)
    with pytest.raises(CommunicationLost, match="joint_2: did not answer in the check move of joint_1"):
        move.check_under_way(status() | {"joint_2": silent})


def moves(bench: Bench) -> list[str]:
    return [entry for entry in bench.drive.trace if entry.startswith(("move", "sweep"))]


async def test_every_axis_is_checked_once_in_a_run_and_before_it_goes_far(bench: Bench) -> None:
    seen: list[CheckMove | None] = []
    move_to = bench.drive.move_to

    async def watched(joint, position, velocity):
        seen.append(bench.runner.check_move)
        await move_to(joint, position, velocity)

    bench.drive.move_to = watched
    await bench.in_a_sweep()
    await bench.runner.pause(bench.campaign.id)
    bench.go_on()
    await bench.over()
    assert moves(bench) == ["move joint_1 0.00872665", "move joint_1 0", "sweep joint_1"]
    moved = moves(bench)[:2]
    bench.drive.trace.clear()
    await bench.resume()  # a new run: somebody may have worked at the machine
    assert (await bench.over()).state is CampaignState.MEASURED
    far = [entry for entry in moves(bench) if entry in ("move joint_1 0.4", "move joint_2 0.3", "move joint_3 -0.2")]
    assert [entry.split()[1] for entry in far] == ["joint_1", "joint_2", "joint_3"]
    moved += [entry for entry in moves(bench) if entry.startswith("move")]
    for entry in far:
        joint = entry.split()[1]
        at = moves(bench).index(entry)
        assert [each.split()[1] for each in moves(bench)[at - 2 : at]] == [joint, joint]
    told = [event for event in bench.store.events(0) if event.kind is EventKind.CHECK_MOVE]
    assert [event.data["axis"] for event in told] == ["joint_1", "joint_1", "joint_2", "joint_3"]
    assert [event.data["number"] for event in told] == [1, 2, 3, 4]
    assert told[3].data["way"] == pytest.approx(-WAY)
    shown = [None if move is None else (move.joint, move.way) for move in seen]  # to a person while it goes
    assert shown[:2] == [("joint_1", pytest.approx(WAY))] * 2  # there and back
    assert sum(one is not None for one in shown) == 2 * len(told)
    assert not any(one for one, entry in zip(shown, moved, strict=True) if entry in far)
    assert bench.runner.check_move is None


async def test_a_stop_that_is_not_confirmed_is_told_wherever_a_person_looks(bench: Bench) -> None:
    """In the cause of campaign and sweep, and as the state of the machine: someone has to look at it."""
    bench.drive.fail[1] = DriveFault("joint_1: over-current")
    bench.drive.stop_error = CommunicationLost("node 1 is silent")
    await bench.start()
    await bench.over()
    told = "the stop is not confirmed: node 1 is silent"
    campaign, sweep = bench.now, bench.store.sweep(bench.campaign.id, 1)
    assert campaign.cause == sweep.cause == f"DriveFault: joint_1: over-current; {told}"
    assert (bench.machine.connected, bench.machine.trouble) == (False, told)


SOON, LATE = 0.05, 3600.0  # s


async def missed(bench: Bench) -> CampaignDocument:
    """Its end, without a sign of life from now on, whatever the computer takes to come here."""
    attendance = bench.runner.attendance
    assert attendance is not None
    attendance.within = SOON
    attendance.renew()
    campaign = await bench.over()
    assert campaign.state is CampaignState.PAUSED
    assert campaign.cause.startswith("no sign of life within 0.05 s")
    return campaign


async def test_without_a_sign_of_life_it_is_paused_at_standstill(bench: Bench, between_motions: Barrier) -> None:  # noqa: F811
    await bench.start(attended=LATE)
    await until(between_motions.reached.is_set)
    over = asyncio.create_task(missed(bench))
    await until_cancelled(bench.campaign.id)
    between_motions.opened.set()
    campaign = await over
    assert bench.machine.stops == ()  # nothing is latched: the next start is a person's
    assert bench.drive.trace[-1] == "stop"
    assert bench.told == [(f"campaign {campaign.id}", campaign.cause)]

    await bench.resume(repeat=True)
    assert (await bench.over()).state is CampaignState.MEASURED


async def test_with_signs_of_life_it_is_measured(bench: Bench) -> None:
    with pytest.raises(Conflict, match="is not running"):
        bench.runner.sign_of_life(bench.campaign.id)
    await bench.start(attended=LATE)
    attendance = bench.runner.sign_of_life(bench.campaign.id)
    assert attendance is not None
    assert attendance.left <= attendance.within == LATE
    assert (await bench.over()).state is CampaignState.MEASURED
    assert bench.runner.attendance is None


@pytest.mark.parametrize(("first", "second", "kept"), [(None, 60.0, 60.0), (LATE, None, LATE), (LATE, 60.0, 60.0)])
async def test_a_pause_that_is_taken_back_keeps_the_sign_of_life_or_takes_that_of_the_resume(
    bench: Bench, first: float | None, second: float | None, kept: float
) -> None:
    await bench.in_a_sweep(2, attended=first)
    await bench.runner.pause(bench.campaign.id)
    assert (await bench.resume(attended=second)).state is CampaignState.RUNNING
    assert bench.runner.attendance is not None
    assert bench.runner.attendance.within == kept
    await missed(bench)  # the sweep is held for ever: nothing else ends it
