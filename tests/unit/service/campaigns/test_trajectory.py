"""Several axes at once: plan, envelope, and what becomes of all of them when one of them does."""

import asyncio
from collections.abc import AsyncIterator
from dataclasses import replace

import numpy as np
import pytest

from drivers.errors import Cause, CauseCode, DriveFault
from drivers.ports import SineCommand, SweepCommand, SweepMode
from service import BadInput, EnvelopeViolation
from service.machine.execution.runner import Runner
from service.machine.execution.sweep_executor import SweepExecutor
from service.model import Robot, SweepSpec
from service.model.configuration import Box, Cell
from service.planning.campaigns.state_machine import SweepEvent, sweep_move
from service.planning.compiled_plan import CompiledPlan
from service.planning.documents import TrajectoryPlan, TrajectoryRequest, at_once
from service.planning.safety.envelope_check import Envelope, commanded_motion, path_of
from service.planning.trajectories import build_trajectory_plan
from service.store.documents import CampaignState, NewSweep, RecordingState, SweepState
from tests.unit.service.campaigns.conftest import SPECTRUM, TIMEOUT, Bench, Taken, nobody_needed, refusing
from tests.unit.service.campaigns.formula_drive import FormulaDrive
from tests.unit.service.campaigns.small_arm import small_arm

pytestmark = pytest.mark.slow

POSE = (-1.0, 0.3)
FIRST = SweepCommand(
    joint="j1",
    mode=SweepMode.HOST_STREAMED,
    offset_velocity=0.0,
    sines=(SineCommand(0.25, 0.3, 0.5), SineCommand(0.5, 0.1, 2.0)),
    period=4.0,
    periods=2,
    ramp=1.0,
    settle=1.0,
    sample_rate=100.0,
    velocity_limit=0.6,
    effort_limit=2000.0,
    position_window=(-1.6, -0.4),
)
SECOND = replace(FIRST, joint="j2", effort_limit=800.0, position_window=(-0.3, 0.9))


def envelope(**cell: object) -> Envelope:
    return Envelope(small_arm(), Cell.model_validate({"name": "test", "joint_margin": 0.02} | cell))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"position_window": (-4.0, -0.4)}, "j1: lower end of the position window -4 rad"),
        ({"position_window": (-1.05, -0.4)}, "j1: position on the trajectory"),
        ({"velocity_limit": 0.9}, "j1: velocity limit 0.9 rad/s is above the limit 0.8"),
        ({"velocity_limit": 0.3}, "j1: peak velocity 0.4 rad/s is above the limit 0.3"),
        ({"effort_limit": 3000.0}, "j1: effort limit 3000 N m is above"),
        ({"effort_limit": 300.0}, "j1: predicted peak effort"),
        ({"periods": 50}, "j1: duration"),
        ({"joint": "j9"}, "j9: robot arm has"),
    ],
)
def test_what_leaves_the_envelope_is_refused(change: dict[str, object], message: str) -> None:
    envelope().check_trajectory([FIRST, SECOND], POSE)
    with pytest.raises(EnvelopeViolation, match=message):
        envelope().check_trajectory([replace(FIRST, **change), SECOND], POSE)


def test_the_path_is_looked_at_with_all_axes_moving() -> None:
    # the tool's ball at the end of the stretched arm sweeps through a wall that no axis alone would reach
    there = commanded_motion(("j1", "j2"), [FIRST, SECOND], POSE).position
    angles = np.cumsum(there, axis=1)
    reach = np.cos(angles).sum(axis=1)
    alone = [
        np.cos(np.cumsum(commanded_motion(("j1", "j2"), [c], POSE).position, axis=1)).sum(axis=1)
        for c in (FIRST, SECOND)
    ]
    furthest, others = reach.max(), max(each.max() for each in alone)
    assert furthest > others + 0.01
    ball, clearance = 0.15, 0.01
    wall = Box(name="wall", center=((furthest + others) / 2 + ball + clearance + 0.5, 0, 2), size=(1, 4, 4))
    cell = envelope(boxes=[wall], clearance=clearance)
    cell.check_trajectory([FIRST], POSE)
    cell.check_trajectory([SECOND], POSE)
    with pytest.raises(EnvelopeViolation, match=r"j1, j2: the trajectory is not free: clearance under 0\.01 m"):
        cell.check_trajectory([FIRST, SECOND], POSE)


def test_a_simultaneous_sweep_has_the_limits_of_a_sweep_and_room_for_all_its_axes_to_leave_their_paths() -> None:
    slow = {"offset_velocity": 0.01, "sines": (SineCommand(2.2, 0.004, 0.0),), "period": 5.0, "periods": 1}
    limits = {"ramp": 0.5, "settle": 0.5, "velocity_limit": 0.02}
    pair = [replace(one, **slow, **limits) for one in (FIRST, SECOND)]
    free = envelope()
    free.check_trajectory(pair, POSE)
    with pytest.raises(EnvelopeViolation, match="j1: travel"):
        free.check_trajectory([replace(pair[0], offset_velocity=0.02, velocity_limit=0.05), pair[1]], POSE)
    # a wall that the paths pass, and both axes at the ends of what `watch_path` allows do not
    away, ball, clearance = free.limits.window_margin, 0.15, 0.01
    angles = np.cumsum(commanded_motion(("j1", "j2"), pair, POSE).position, axis=1)
    reach = np.cos(angles).sum(axis=1).max()
    both = np.cos(angles + away * np.array([1.0, 2.0])).sum(axis=1).max()
    assert both > reach + 1e-3
    wall = Box(name="wall", center=((reach + both) / 2 + ball + clearance + 0.5, 0, 2), size=(1, 4, 4))
    cell = envelope(boxes=[wall], clearance=clearance)
    with pytest.raises(EnvelopeViolation, match="j1, j2: the trajectory is not free"):
        cell.check_trajectory(pair, POSE)


def test_the_acceleration_of_the_highest_line_of_a_request_is_seen() -> None:
    line = SineCommand(8.0, 0.01, 0.0)  # Hz, rad/s, rad: 16 harmonics of 2 s
    motion = commanded_motion(("j1", "j2"), [replace(FIRST, sines=(line,))], POSE)
    assert np.abs(motion.acceleration).max() == pytest.approx(2 * np.pi * 8.0 * 0.01, rel=0.01)


def test_an_axis_that_leaves_its_path_is_noticed() -> None:
    drive = FormulaDrive(("j1", "j2"))
    samples = drive.samples(FIRST)
    on_path = replace(samples, position=POSE[0] + path_of(FIRST, samples.time))
    envelope().watch_path(FIRST, POSE[0], on_path)
    astray = replace(on_path, position=on_path.position + np.linspace(0, 0.03, len(samples.time)))
    with pytest.raises(EnvelopeViolation, match=r"j1: distance from the trajectory 0\.020\d+ rad is outside"):
        envelope().watch_path(FIRST, POSE[0], astray)


def request(**changes: object) -> TrajectoryRequest:
    wanted = {"kind": "trajectory", "robot_id": 1, "axes": ("j1", "j2"), "trajectories": 2, "period": 4.0}
    return TrajectoryRequest.model_validate(wanted | changes)


def test_a_plan_moves_all_axes_of_a_trajectory_at_once() -> None:
    cell = Cell(name="test", home={"j1": -1.0})
    plan = build_trajectory_plan(small_arm(), request(), cell)
    assert TrajectoryPlan.model_validate_json(plan.model_dump_json()) == plan
    assert at_once(plan.sweeps) == ((1, 2), (3, 4))
    assert [sweep.spec.block for sweep in plan.sweeps] == ["trajectory 1 of 2 axes"] * 2 + [
        "trajectory 2 of 2 axes"
    ] * 2
    for numbers in at_once(plan.sweeps):
        commands = [plan.sweeps[number - 1].command() for number in numbers]
        pose = plan.sweeps[numbers[0] - 1].spec.pose
        Envelope(small_arm(), cell).check_trajectory(commands, pose)
        for command in commands:
            assert sum(sine.amplitude for sine in command.sines) <= 0.5 + 1e-9
    assert plan.condition[0] != plan.condition[1]


def test_axes_that_are_not_named_stay_at_home(robot: Robot) -> None:
    plan = build_trajectory_plan(
        robot,
        request(axes=("joint_3", "joint_5"), trajectories=1, harmonics=2),
        Cell(name="empty", home={"joint_2": 0.2}),
    )
    assert [sweep.spec.axis for sweep in plan.sweeps] == ["joint_3", "joint_5"]
    pose = plan.sweeps[0].spec.pose
    assert (pose[0], pose[1], pose[3], pose[5]) == (0.0, 0.2, 0.0, 0.0)


@pytest.mark.parametrize(
    ("change", "place"),
    [({"axes": ("j1", "j9")}, "axes"), ({"axes": ("j1", "j1")}, "axes"), ({"velocity": 2.0}, "velocity")],
)
def test_a_request_that_cannot_be_met_names_its_field(change: dict[str, object], place: str) -> None:
    with pytest.raises(BadInput) as refused:
        build_trajectory_plan(small_arm(), request(**change), Cell(name="test"))
    assert refused.value.place == place


JOINTS = ("joint_1", "joint_2")
SINES = (SineCommand(0.5, 0.01, 0.3),)


def command(joint: str) -> SweepCommand:
    return replace(
        FIRST, joint=joint, sines=SINES, period=2.0, sample_rate=250.0, effort_limit=3000.0, position_window=(-0.1, 0.1)
    )


Trajectory = tuple[Runner, int]


@pytest.fixture
async def campaign(bench: Bench, envelope_of_max100: Envelope) -> AsyncIterator[Trajectory]:
    """One trajectory of two axes, and a runner that knows that they belong together."""
    specs = [
        SweepSpec.model_validate(
            {"id": joint, "axis": joint, "pose": (0.0,) * 6, "offset_velocity": 0.0, "excitation": "trajectory"}
            | {"sines": [{"frequency": 0.5, "amplitude": 0.01, "phase": 0.3}], "period": 2.0, "periods": 2}
            | {"measure_from": 2.0, "sample_rate": 250.0, "block": "trajectory 1 of 2 axes"}
        )
        for joint in JOINTS
    ]
    plan = bench.store.add_plan(1, {})
    campaign = bench.store.add_campaign(plan.id, [NewSweep(spec=spec, mode=SweepMode.HOST_STREAMED) for spec in specs])
    commands = {number: command(joint) for number, joint in enumerate(JOINTS, 1)}
    joints = tuple(f"joint_{number}" for number in range(1, 7))
    compiled = CompiledPlan(joints, commands, envelope_of_max100, 0.1, 2e-3, trajectories=((1, 2),))
    executor = SweepExecutor(bench.store, bench.files, bench.machine, bench.hub)
    runner = Runner(bench.store, bench.machine, executor, bench.jobs, lambda _: compiled, nobody_needed(bench.database))
    yield runner, campaign.id
    await runner.close()
    executor.close()


async def over(bench: Bench, runner: Runner) -> None:
    await asyncio.wait_for(runner.finished(), TIMEOUT)
    assert bench.drive.energised == set()


@pytest.fixture
def envelope_of_max100(robot: Robot) -> Envelope:
    return Envelope(robot, Cell(name="empty"))


async def test_trouble_with_one_axis_fails_all_and_all_are_repeated(bench: Bench, campaign: Trajectory) -> None:
    runner, number = campaign
    bench.drive.fail[3] = DriveFault("joint_2: fault 8611h")
    await runner.start(number, bench.intention)
    await over(bench, runner)
    assert bench.store.campaign(number).state is CampaignState.PAUSED
    for sweep in bench.store.sweeps(number):
        assert (sweep.state, sweep.cause) == (SweepState.FAILED, "DriveFault: joint_2: fault 8611h")
        assert bench.store.recording(number, sweep.number).state is RecordingState.PARTIAL
    assert bench.files.streams() == {}
    bench.drive.fail.clear()
    await runner.resume(number, bench.intention, repeat=True)
    await over(bench, runner)
    assert [(sweep.state, sweep.attempt) for sweep in bench.store.sweeps(number)] == [(SweepState.RECORDED, 2)] * 2


async def test_a_trajectory_of_which_one_axis_was_identified_does_not_block_its_campaign(
    bench: Bench, campaign: Trajectory
) -> None:
    runner, number = campaign
    store, identify, fail = bench.store, sweep_move(SweepEvent.IDENTIFY), sweep_move(SweepEvent.FAIL)
    bench.drive.hold = 2
    await runner.start(number, bench.intention)
    await asyncio.wait_for(bench.drive.holding.wait(), TIMEOUT)
    await runner.pause(number)
    bench.go_on()
    await over(bench, runner)
    store.add_estimate([(store.sweep(number, 1), SPECTRUM)], identify, {})
    store.move_sweep(number, 2, fail, Cause(CauseCode.NOT_IDENTIFIED))
    before = len(bench.drive.trace)
    await runner.resume(number, bench.intention, repeat=True)
    await over(bench, runner)
    ended = store.campaign(number)
    assert (ended.state, ended.sweeps) == (CampaignState.COMPLETED, {SweepState.IDENTIFIED: 1, SweepState.SKIPPED: 1})
    assert store.sweep(number, 2).cause == ended.cause
    assert "can only be repeated completely" in ended.cause
    assert not any(entry.startswith(("enable", "sweep")) for entry in bench.drive.trace[before:])


async def test_what_was_recorded_is_identified_also_where_the_end_of_another_axis_is_refused(
    bench: Bench, campaign: Trajectory
) -> None:
    runner, number = campaign
    with refusing(bench, "UPDATE ON sweep WHEN NEW.number = 2 AND NEW.state = 'recorded'"):
        await runner.start(number, bench.intention)
        await over(bench, runner)
    assert [sweep.state for sweep in bench.store.sweeps(number)] == [SweepState.RECORDED, SweepState.FAILED]
    assert isinstance(bench.jobs, Taken)
    assert bench.jobs.sweeps == [1]
