"""Plans of the arm and of the MAX 100 class robot: what is promised of poses, ways, sweeps and their order."""

from pathlib import Path

import numpy as np
import pytest

from drivers.ports import SweepMode
from service.identification.design.pose_selection import Criterion
from service.identification.model.base_parameters import base_parameters, condition_number
from service.identification.model.regressor import inertia_rows, lock
from service.model.configuration import Box, Cell, read_cell, read_robot
from service.model.errors import BadInput
from service.model.robot import Robot, build_robot
from service.planning.documents import PlanDocument, PlanRequest
from service.planning.plan import build_plan
from service.planning.poses import workspace_grid
from service.planning.safety.envelope import Envelope
from service.planning.safety.travel import order_poses
from tests.unit.service.campaigns.small_arm import small_arm

CONFIG = Path(__file__).parents[4] / "config"
REQUEST = PlanRequest(
    robot_id=1,
    axes=("joint_1", "joint_2", "joint_3"),
    varied=("joint_2", "joint_3"),
    modes="one_host_streamed",
    locked_rotor={"joint_1": 5.0},
)


@pytest.fixture
def arm() -> Robot:
    return small_arm()


@pytest.fixture(scope="module")
def max100() -> Robot:
    return read_robot(CONFIG / "robots" / "max100-class.yaml")


@pytest.fixture(scope="module")
def workshop() -> Cell:
    return read_cell(CONFIG / "cells" / "workshop.yaml")


@pytest.fixture(scope="module")
def plan(max100: Robot, workshop: Cell) -> PlanDocument:
    return build_plan(max100, REQUEST, workshop)


def test_24_poses_three_axes(plan: PlanDocument) -> None:
    assert len(plan.sweeps) == 72
    assert len({sweep.spec.pose for sweep in plan.sweeps}) == 24
    assert [sweep.spec.id for sweep in plan.sweeps] == [f"{k:04d}" for k in range(1, 73)]
    assert not plan.dropped
    assert len(plan.base_parameters) == 11


def test_poses_lie_on_the_grid_and_only_varied_axes_vary(plan: PlanDocument) -> None:
    poses = np.degrees([sweep.spec.pose for sweep in plan.sweeps])
    assert np.abs(poses[:, 1:3] / 5 - np.round(poses[:, 1:3] / 5)).max() < 1e-9
    assert not poses[:, [0, 3, 4, 5]].any()


def test_every_leg_and_sweep_passes_the_envelope_in_turn(plan: PlanDocument, max100: Robot, workshop: Cell) -> None:
    envelope = Envelope(max100, workshop)
    here = np.zeros(6)
    for sweep in plan.sweeps:
        for leg in sweep.legs:
            envelope.check_move(leg.joint, here.tolist(), leg.target, 0.1)
            here[max100.index(leg.joint)] = leg.target
        assert np.abs(here - sweep.spec.pose).max() < 1e-3
        command = sweep.command()
        envelope.check_sweep(command, sweep.spec.pose)
        index = max100.index(sweep.spec.axis)
        here[index] += command.offset_velocity * (command.ramp + command.settle + command.period * command.periods)


def test_one_host_streamed_sweep_an_axis(plan: PlanDocument) -> None:
    streamed = [sweep.spec.axis for sweep in plan.sweeps if sweep.mode is SweepMode.HOST_STREAMED]
    assert sorted(streamed) == ["joint_1", "joint_2", "joint_3"]


def test_condition_beats_random_choices(max100: Robot, workshop: Cell) -> None:
    """Against 20 random choices of as many poses out of the same workspace, by the condition number of an SVD."""
    chain = lock(max100.chain, {3: 0.0, 4: 0.0, 5: 0.0})
    base = base_parameters(chain, (0, 1, 2))
    grid = workspace_grid(max100, REQUEST, workshop)
    rng = np.random.default_rng(0)

    def condition(poses: np.ndarray) -> float:
        return condition_number(np.vstack([base.rows(chain, axis, poses[:, :3]) for axis in range(3)]))

    plan = build_plan(max100, REQUEST.model_copy(update={"criterion": Criterion.CONDITION}), workshop)
    chosen = np.array([sweep.spec.pose for sweep in plan.sweeps[::3]])
    assert condition(chosen) < 0.8 * min(condition(rng.permutation(grid)[:24]) for _ in range(20))
    assert plan.condition[0] is None  # one pose alone cannot tell the parameters apart


def test_document_survives_json_and_the_plan_is_deterministic(
    plan: PlanDocument, max100: Robot, workshop: Cell
) -> None:
    assert PlanDocument.model_validate_json(plan.model_dump_json()) == plan
    assert build_plan(max100, REQUEST, workshop) == plan


def test_lines_stay_below_the_locked_rotor_frequency(plan: PlanDocument, max100: Robot, workshop: Cell) -> None:
    """5 Hz in the most stretched pose, more where the load is lighter."""
    grid = workspace_grid(max100, REQUEST, workshop)
    load = inertia_rows(max100.chain, 0, grid) @ max100.chain.inertial.ravel()
    for sweep in plan.sweeps[::3]:
        assert sweep.spec.axis == "joint_1"
        own = inertia_rows(max100.chain, 0, np.array(sweep.spec.pose)) @ max100.chain.inertial.ravel()
        resonance = 5.0 * np.sqrt(load.max() / own[0])
        assert max(sine.frequency for sine in sweep.spec.sines) <= 0.8 * resonance


def test_way_is_much_shorter_than_the_order_of_choice() -> None:
    poses = np.random.default_rng(1).uniform(-1, 1, (40, 3))

    def length(order: list[int]) -> float:
        way = np.vstack([np.zeros(3), poses[order]])
        return float(np.abs(np.diff(way, axis=0)).sum())

    order = order_poses(poses, np.zeros(3))
    assert sorted(order) == list(range(40))
    assert length(order) < 0.6 * length(list(range(40)))


def test_no_stretch_of_the_way_is_better_reversed() -> None:
    poses = np.random.default_rng(2).uniform(-1, 1, (60, 2))
    way = np.vstack([np.zeros(2), poses[order_poses(poses, np.zeros(2))]])

    def length(points: np.ndarray) -> float:
        return float(np.abs(np.diff(points, axis=0)).sum())

    whole = length(way)
    for i in range(1, 60):
        for j in range(i + 2, 62):
            assert length(np.vstack([way[:i], way[i:j][::-1], way[j:]])) > whole - 1e-9


def test_few_and_many_poses_have_an_order() -> None:
    start = np.zeros(2)
    assert order_poses(np.zeros((0, 2)), start) == []
    assert order_poses(np.ones((1, 2)), start) == [0]
    assert sorted(order_poses(np.random.default_rng(3).uniform(-1, 1, (300, 2)), start)) == list(range(300))


@pytest.mark.slow
def test_a_pose_behind_a_wall_is_dropped_with_its_reason(arm: Robot) -> None:
    # a wall on top of the shoulder: the arm bent over it is free, but no single axis can bring it there
    wall = Box(name="wall", center=(0.0, 0.0, 2.6), size=(0.02, 1.0, 2.4))
    request = PlanRequest(robot_id=1, axes=("j1",), varied=("j1", "j2"), step=15.0, poses=60)
    plan = build_plan(arm, request, Cell(name="walled", boxes=(wall,), floor=0.0))
    assert plan.dropped
    assert all("no collision-free path of single-axis moves" in pose.reason for pose in plan.dropped)
    assert plan.sweeps


@pytest.mark.parametrize(("lower", "upper"), [(-6.2, 6.2), (1.0, 9.0), (-9.0, -1.0)])
def test_a_joint_that_turns_more_than_once_is_planned_over_one_turn(arm: Robot, lower: float, upper: float) -> None:
    text = arm.urdf_text.replace('lower="-2.9" upper="2.9"', f'lower="{lower}" upper="{upper}"')
    wide = build_robot(arm.description, text)
    request = PlanRequest(robot_id=1, axes=("j1",), varied=("j2",), step=10.0)
    cell = Cell(name="wide", ignored_pairs=(("base", "fore"), ("base", "tool"), ("upper", "tool")), home={"j2": upper})
    positions = workspace_grid(wide, request, cell)[:, 1]
    assert len(positions) == 36
    assert lower <= positions.min() <= positions.max() <= upper
    turned = np.sort(np.degrees(positions) % 360).round(6) % 360
    assert len(np.unique(turned)) == 36


def test_workspace_is_the_free_part_of_the_grid(max100: Robot, workshop: Cell, plan: PlanDocument) -> None:
    grid = workspace_grid(max100, REQUEST, workshop)
    assert plan.measurable <= len(grid) < plan.candidates
    assert Envelope(max100, workshop).checker.collision_free(grid).all()


def test_lines_and_rate_of_one_s_choice(max100: Robot, workshop: Cell) -> None:
    """Calibration sweeps: lines above the free resonance, traced at 1 kHz, within the same envelope."""
    lines = (90.0, 2.0, 5.0, 40.0, 60.0)
    request = REQUEST.model_copy(
        update={"lines": lines, "sample_rate": 1000.0, "poses": 2, "locked_rotor": {}, "modes": "drive_side"}
    )
    plan = build_plan(max100, request, workshop)
    assert {sweep.spec.axis for sweep in plan.sweeps} == set(request.axes)
    envelope = Envelope(max100, workshop)
    for sweep in plan.sweeps:
        assert [sine.frequency for sine in sweep.spec.sines] == sorted(lines)
        assert sum(sine.amplitude for sine in sweep.spec.sines) < abs(sweep.spec.offset_velocity)
        assert sweep.spec.sample_rate == 1000.0
        envelope.check_sweep(sweep.command(), sweep.spec.pose)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"lines": (2.0, 2.5)}, "lines: 2.5 Hz is not a whole number of Hz"),
        ({"lines": (0.0, 2.0)}, "lines: 0.0 Hz is not a whole number of Hz above 0"),
        ({"lines": (3.0, 3.0)}, "lines: names a frequency twice"),
        ({"lines": (2.0, 90.0)}, "sample_rate: 250.0 Hz is below 900.0 Hz"),
        ({"axes": ("joint_9",)}, "axes: unknown joint joint_9"),
        ({"varied": ("joint_2", "joint_2")}, "varied: names a joint twice"),
        ({"poses": 1000}, "poses: 1000 requested"),
        ({"sample_rate": 20.0}, "sample_rate: 20.0 Hz is below 50.0 Hz"),
        ({"locked_rotor": {"joint_1": 1.5}}, "locked_rotor.joint_1: 1.5 Hz is not above"),
        ({"step": 0.5, "varied": ("joint_1", "joint_2", "joint_3")}, "step: 0.5 gives a grid"),
    ],
)
def test_bad_requests_name_the_field(max100: Robot, workshop: Cell, change: dict[str, object], message: str) -> None:
    with pytest.raises(BadInput, match=message):
        build_plan(max100, REQUEST.model_copy(update=change), workshop)


def test_realisations_of_a_sweep_differ_in_their_phases_and_pass_the_envelope(arm: Robot) -> None:
    request = PlanRequest(robot_id=1, axes=("j1", "j2"), varied=("j1", "j2"), step=20.0, poses=3, realisations=4)
    cell = Cell(name="plain", floor=0.0)
    plan, once = (build_plan(arm, one, cell) for one in (request, request.model_copy(update={"realisations": 1})))
    assert len(plan.sweeps) == 4 * len(once.sweeps) == 24
    envelope = Envelope(arm, cell)
    seen: set[tuple[float, ...]] = set()
    for sweep in plan.sweeps:
        (designed,) = (
            one for one in once.sweeps if (one.spec.axis, one.spec.pose) == (sweep.spec.axis, sweep.spec.pose)
        )
        for sine, other in zip(sweep.spec.sines, designed.spec.sines, strict=True):
            assert (sine.frequency, sine.amplitude) == (other.frequency, other.amplitude)
        assert sweep.spec.offset_velocity == designed.spec.offset_velocity
        seen.add(tuple(sine.phase for sine in sweep.spec.sines))
        envelope.check_sweep(sweep.command(), sweep.spec.pose)
    assert len(seen) == 24
    told, alone = plan.confidence[-1], once.confidence[-1]
    assert told is not None
    assert alone is not None
    assert told == pytest.approx(alone / 2, rel=0.05)  # four times the information
