"""Plans of the arm and of the MAX 100 class robot: what is promised of poses, ways, sweeps and their order.

Then the warm-up, and the plans of an initial analysis, of a diagnosis and of its experiments.
"""

import json
from dataclasses import replace
from datetime import UTC, datetime
from itertools import pairwise
from math import nan
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from drivers.ports import NoiseCommand, SweepCommand, SweepMode
from service import BadInput, EnvelopeViolation
from service.identification.axis.ideal_frequency import InitialAnalysis, PoseAnalysis
from service.identification.design.diagnosis_sweeps import BLOCKS, DesignedSweep, full_design
from service.identification.design.excitation import Excitation
from service.identification.design.pose_selection import Criterion
from service.identification.estimates.torque_gain import KnownMass
from service.identification.model import condition_number, gravity_terms, inertia_rows, lock
from service.identification.model.base_parameters import base_parameters
from service.identification.spectra.noise_response import FrequencyResponse
from service.model import Robot, SweepPurpose, build_robot
from service.model.configuration import Box, Cell, read_cell
from service.model.results.estimate import Ideal
from service.planning.analysis import build_analysis_plan
from service.planning.compiled_plan import plan_of
from service.planning.diagnosis import build_diagnosis_plan, build_experiment_plan
from service.planning.documents import (
    AnalysisPlan,
    AnalysisRequest,
    DiagnosisPlan,
    DiagnosisRequest,
    ExperimentRequest,
    PlanDocument,
    PlanRequest,
    at_once,
    limits,
)
from service.planning.plan import build_plan
from service.planning.poses import grid, least_duration, workspace_grid
from service.planning.safety.envelope_check import Envelope, noise_effort, noise_velocity, noise_way
from service.planning.safety.travel import order_poses
from service.store.documents import BoltedMass, PlanRecord
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
def cell(root: Path) -> Cell:
    return read_cell(root / "config/cells/workshop.yaml")


@pytest.fixture(scope="module")
def plan(robot: Robot, cell: Cell) -> PlanDocument:
    return build_plan(robot, REQUEST, cell)


def test_24_poses_three_axes(plan: PlanDocument, robot: Robot, cell: Cell) -> None:
    assert len(plan.sweeps) == 72
    assert len({sweep.spec.pose for sweep in plan.sweeps}) == 24
    assert [sweep.spec.id for sweep in plan.sweeps] == [f"{k:04d}" for k in range(1, 73)]
    assert not plan.dropped
    assert len(plan.base_parameters) == 11
    # poses lie on the grid, and only varied axes vary
    poses = np.degrees([sweep.spec.pose for sweep in plan.sweeps])
    assert np.abs(poses[:, 1:3] / 5 - np.round(poses[:, 1:3] / 5)).max() < 1e-9
    assert not poses[:, [0, 3, 4, 5]].any()
    streamed = [sweep.spec.axis for sweep in plan.sweeps if sweep.mode is SweepMode.HOST_STREAMED]
    assert sorted(streamed) == ["joint_1", "joint_2", "joint_3"]  # one of each
    grid = workspace_grid(robot, REQUEST, cell)
    assert plan.measurable <= len(grid) < plan.candidates
    assert Envelope(robot, cell).checker.collision_free(grid).all()
    assert PlanDocument.model_validate_json(plan.model_dump_json()) == plan
    assert build_plan(robot, REQUEST, cell) == plan


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["plan", "diagnosis"])
def test_every_leg_and_sweep_passes_the_envelope_in_turn(
    request: pytest.FixtureRequest, kind: str, robot: Robot, cell: Cell
) -> None:
    plan: PlanDocument | DiagnosisPlan = request.getfixturevalue(kind)
    envelope = Envelope(robot, cell, plan.limits if isinstance(plan, DiagnosisPlan) else None)
    here = np.array(cell.home_pose(robot.joints))
    for sweep in plan.sweeps:
        for leg in sweep.legs:
            envelope.check_move(leg.joint, here.tolist(), leg.target, 0.1)
            here[robot.index(leg.joint)] = leg.target
        assert here == pytest.approx(sweep.spec.pose, abs=2e-4)
        command = sweep.command()
        assert isinstance(command, SweepCommand)
        envelope.check_sweep(command, sweep.spec.pose)
        way = command.offset_velocity * (command.ramp + command.settle + command.period * command.periods)
        here[robot.index(sweep.spec.axis)] += way
    assert plan.dropped == ()


def test_condition_beats_random_choices(robot: Robot, cell: Cell) -> None:
    """Against 20 random choices of as many poses out of the same workspace, by the condition number of an SVD."""
    chain = lock(robot.chain, {3: 0.0, 4: 0.0, 5: 0.0})
    base = base_parameters(chain, (0, 1, 2))
    grid = workspace_grid(robot, REQUEST, cell)
    rng = np.random.default_rng(0)

    def condition(poses: np.ndarray) -> float:
        return condition_number(np.vstack([base.rows(chain, axis, poses[:, :3]) for axis in range(3)]))

    plan = build_plan(robot, REQUEST.model_copy(update={"criterion": Criterion.CONDITION}), cell)
    chosen = np.array([sweep.spec.pose for sweep in plan.sweeps[::3]])
    assert condition(chosen) < 0.8 * min(condition(rng.permutation(grid)[:24]) for _ in range(20))
    assert plan.condition[0] is None  # one pose alone cannot tell the parameters apart


def test_lines_stay_below_the_locked_rotor_frequency(plan: PlanDocument, robot: Robot, cell: Cell) -> None:
    """5 Hz in the most stretched pose, more where the load is lighter."""
    grid = workspace_grid(robot, REQUEST, cell)
    load = inertia_rows(robot.chain, 0, grid) @ robot.chain.inertial.ravel()
    for sweep in plan.sweeps[::3]:
        assert sweep.spec.axis == "joint_1"
        own = inertia_rows(robot.chain, 0, np.array(sweep.spec.pose)) @ robot.chain.inertial.ravel()
        resonance = 5.0 * np.sqrt(load.max() / own[0])
        assert max(sine.frequency for sine in sweep.spec.sines) <= 0.8 * resonance


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


def test_a_large_grid_is_filled_evenly(robot: Robot, cell: Cell) -> None:
    """Six axes at 5 degrees: 248,443,200 poses."""
    request = PlanRequest(robot_id=1, axes=robot.joints, varied=robot.joints[1:])
    envelope = Envelope(robot, cell)
    poses = np.degrees(grid(robot, request, envelope, np.zeros(6)))
    assert len(np.unique(poses, axis=0)) == len(poses) == 4096
    assert np.abs(poses / 5 - np.round(poses / 5)).max() < 1e-9
    assert not poses[:, 0].any()
    for k in range(1, 6):
        low, high = np.degrees(envelope.joint_range(k))
        counts = np.histogram(poses[:, k], 8, (max(low, -180.0), min(high, 180.0)))[0]
        assert counts.min() > 0.7 * 4096 / 8
        assert counts.max() < 1.3 * 4096 / 8


def test_lines_and_rate_of_one_s_choice(robot: Robot, cell: Cell) -> None:
    """Calibration sweeps: lines above the free resonance, traced at 1 kHz, within the same envelope."""
    lines = (90.0, 2.0, 5.0, 40.0, 60.0)
    request = REQUEST.model_copy(
        update={"lines": lines, "sample_rate": 1000.0, "poses": 2, "locked_rotor": {}, "modes": "drive_side"}
    )
    plan = build_plan(robot, request, cell)
    assert {sweep.spec.axis for sweep in plan.sweeps} == set(request.axes)
    envelope = Envelope(robot, cell)
    for sweep in plan.sweeps:
        assert [sine.frequency for sine in sweep.spec.sines] == sorted(lines)
        assert sum(sine.amplitude for sine in sweep.spec.sines) < abs(sweep.spec.offset_velocity)
        assert sweep.spec.sample_rate == 1000.0
        envelope.check_sweep(sweep.command(), sweep.spec.pose)


ANALYSIS = {"kind": "analysis", "robot_id": 1, "axes": ("joint_1", "joint_3"), "varied": ("joint_2", "joint_3")}
DIAGNOSIS = {"kind": "diagnosis", "robot_id": 1, "axes": ("joint_1", "joint_2"), "varied": ("joint_1", "joint_2")}


def built(kind: str, change: dict[str, object], robot: Robot, cell: Cell) -> object:
    """A plan of this kind with a changed request."""
    if kind == "analysis":
        return build_analysis_plan(robot, AnalysisRequest.model_validate(ANALYSIS | change), cell)
    if kind == "diagnosis":
        return build_diagnosis_plan(robot, DiagnosisRequest.model_validate(DIAGNOSIS | change), cell)
    return build_plan(robot, REQUEST.model_copy(update=change), cell)


@pytest.mark.parametrize(
    ("kind", "change", "message"),
    [
        ("plan", {"lines": (2.0, 2.5)}, "lines: 2.5 Hz is not a whole number of Hz"),
        ("plan", {"lines": (0.0, 2.0)}, "lines: 0.0 Hz is not a whole number of Hz above 0"),
        ("plan", {"lines": (3.0, 3.0)}, "lines: names a frequency twice"),
        ("plan", {"lines": (2.0, 90.0)}, "sample_rate: 250.0 Hz is below 900.0 Hz"),
        ("plan", {"axes": ("joint_9",)}, "axes: unknown joint joint_9"),
        ("plan", {"varied": ("joint_2", "joint_2")}, "varied: names a joint twice"),
        ("plan", {"poses": 1000}, "poses: 1000 requested"),
        ("plan", {"sample_rate": 20.0}, "sample_rate: 20.0 Hz is below 50.0 Hz"),
        ("plan", {"locked_rotor": {"joint_1": 1.5}}, "locked_rotor.joint_1: 1.5 Hz is not above"),
        ("analysis", {"axes": ("joint_9",)}, "^axes: "),
        ("analysis", {"poses": 100, "step": 60.0}, "^poses: "),
        ("analysis", {"varied": ("x",)}, "^varied: "),
        ("diagnosis", {"blocks": ("forward_slow", "sideways")}, "blocks: unknown block sideways; there are forward_sl"),
        ("diagnosis", {"blocks": ("wide", "wide")}, "blocks: names a block twice"),
        ("diagnosis", {"axes": ("joint_9",)}, "axes: unknown joint joint_9"),
        ("diagnosis", {"poses": 90, "step": 60.0}, "poses: 90 requested, but of"),
    ],
)
def test_bad_requests_name_the_field(
    robot: Robot, cell: Cell, kind: str, change: dict[str, object], message: str
) -> None:
    with pytest.raises(BadInput, match=message):
        built(kind, change, robot, cell)


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


def test_axes_that_need_less_robot_time_together_move_at_once(arm: Robot) -> None:
    cell = Cell(name="plain", floor=0.0)
    request = PlanRequest(
        robot_id=1, axes=("j1", "j2"), varied=("j1", "j2"), step=20.0, confidence=2.0, simultaneous=True
    )
    plan = build_plan(arm, request, cell)
    assert PlanDocument.model_validate_json(plan.model_dump_json()) == plan
    assert plan.groups == (("j1", "j2"),)
    assert plan.request == request
    single = build_plan(arm, request.model_copy(update={"simultaneous": False}), cell)
    alone, *together = plan.compared
    assert (alone.groups, alone.duration, alone.confidence) == ((), single.duration, single.confidence[-1])
    assert plan.duration == min(one.duration or np.inf for one in together) < single.duration
    assert max(one.confidence or np.inf for one in plan.compared) <= 2.0

    envelope = Envelope(arm, cell)
    for pair in at_once(plan.sweeps):
        first, second = (plan.sweeps[number - 1] for number in pair)
        assert (first.spec.axis, second.spec.axis, second.legs, second.duration) == ("j1", "j2", (), 0.0)
        assert not {sine.frequency for sine in first.spec.sines} & {sine.frequency for sine in second.spec.sines}
        envelope.check_trajectory([first.command(), second.command()], first.spec.pose)
    assert plan.duration == pytest.approx(sum(sweep.duration for sweep in plan.sweeps))
    assert sum(map(len, at_once(plan.sweeps))) == len(plan.sweeps)


LIGHT = {"motor_inertia": 1e-5}  # j2: 0.1 kg m^2 of 3.6


@pytest.mark.parametrize("drive", [LIGHT, LIGHT | {"speed_gain": 1e6}])
def test_axes_whose_neighbours_would_stop_them_go_alone(arm: Robot, drive: dict[str, float]) -> None:
    """Stretched out, M_12 = 1 + 10 (0.25 + 0.5) kg m^2, 2.36 M_22: with its deviation j1 moves j2 by 3.1 times what its
    own sines do, unless its drive holds it.
    """
    axes = (arm.axes[0], arm.axes[1].model_copy(update=drive))
    light = build_robot(arm.description.model_copy(update={"axes": axes}), arm.urdf_text)
    request = PlanRequest(robot_id=1, axes=("j1", "j2"), varied=("j1",), step=20.0, poses=4, simultaneous=True)
    plan = build_plan(light, request, Cell(name="plain"))
    held = "speed_gain" in drive
    assert plan.groups == ((("j1", "j2"),) if held else ())
    assert plan.alone == ("" if held else "j1, j2 alone: the sines of j1 would move j2 by 3.1 times its own, limit 1.4")


def test_sweeps_at_once_leave_each_axis_a_tenth_of_its_speed(arm: Robot) -> None:
    axes = (arm.axes[0], arm.axes[1].model_copy(update={"motor_inertia": 2e-4}))
    light = build_robot(arm.description.model_copy(update={"axes": axes}), arm.urdf_text)
    request = PlanRequest(robot_id=1, axes=("j1", "j2"), varied=("j1", "j2"), step=20.0, poses=8, simultaneous=True)
    plan = build_plan(light, request, Cell(name="plain"))
    weaker = 0
    for pair in at_once(plan.sweeps):
        one, other = (plan.sweeps[number - 1].spec for number in pair)
        both = 1 + 10 * (0.25 + 0.5 * np.cos(other.pose[1]))  # M_12 by hand, kg m^2
        by_neighbour = 1.3 * abs(both) / (2 + 1 + 2.5) * sum(sine.amplitude for sine in one.sines)
        taken = sum(sine.amplitude for sine in other.sines) + by_neighbour
        assert taken < 0.9 * abs(other.offset_velocity) * 1.1  # M_12 changes over 4 deg
        weaker += sum(sine.amplitude for sine in other.sines) < 0.79 * abs(other.offset_velocity)
    assert weaker


def test_one_axis_moves_alone_and_what_single_axes_need_is_refused_together() -> None:
    one = warmed(axes=("j1",), simultaneous=True)
    assert (one.groups, len(one.compared), at_once(one.sweeps)) == ((), 1, ())
    for field, value in {"lines": (2.0, 3.0), "warm_up": 60.0, "prior_from": (1, 2, 3, 4)}.items():
        with pytest.raises(BadInput, match=f"{field}: cannot be combined with simultaneous sweeps"):
            warmed(simultaneous=True, **{field: value})


def warmed(**fields: object) -> PlanDocument:
    wanted = {"robot_id": 1, "axes": ("j1", "j2"), "varied": ("j1", "j2"), "step": 20.0, "poses": 4} | fields
    return build_plan(small_arm(), PlanRequest.model_validate(wanted), Cell(name="plain", floor=0.0))


def test_all_axes_in_turn_in_the_first_pose_for_the_time_wanted() -> None:
    cold, document = warmed(), warmed(warm_up=60.0)
    warm = [sweep for sweep in document.sweeps if sweep.spec.purpose is SweepPurpose.WARM_UP]
    assert document.sweeps[: len(warm)] == tuple(warm)
    assert {sweep.spec.pose for sweep in warm} == {document.sweeps[len(warm)].spec.pose}
    assert [sweep.spec.axis for sweep in warm] == ["j1", "j2"] * (len(warm) // 2)
    assert [sweep.spec.repeat for sweep in warm] == [n // 2 for n in range(len(warm))]
    took = sum(sweep.duration for sweep in warm)
    one_round = took / (len(warm) / 2)
    assert 60.0 <= took < 60.0 + 3 * one_round
    assert not any(sweep.spec.shows_inertia for sweep in warm)

    measured = document.sweeps[len(warm) :]
    assert [(s.spec.axis, s.spec.pose, s.spec.sines) for s in measured] == [
        (s.spec.axis, s.spec.pose, s.spec.sines) for s in cold.sweeps
    ]
    assert all(sweep.spec.shows_inertia for sweep in measured)
    starts = [sweep.spec.started_at for sweep in document.sweeps]
    assert starts == sorted(starts)
    assert [sweep.spec.id for sweep in document.sweeps] == [f"{n:04d}" for n in range(1, len(starts) + 1)]


def test_warm_up_sweeps_are_none_unless_wanted_and_the_one_streamed_sweep_is_no_such() -> None:
    document = warmed(warm_up=30.0, modes="one_host_streamed")
    streamed = [sweep for sweep in document.sweeps if sweep.mode is SweepMode.HOST_STREAMED]
    assert sorted(sweep.spec.axis for sweep in streamed) == ["j1", "j2"]
    assert all(sweep.spec.shows_inertia for sweep in streamed)
    assert all(sweep.spec.purpose is not SweepPurpose.WARM_UP for sweep in warmed().sweeps)
    assert least_duration([Excitation(0.01, (), 1.0, 5, 0.5, 0.5)]) > 6.5
    with pytest.raises(ValidationError, match="less than or equal to 7200"):
        warmed(warm_up=1e6)


@pytest.fixture(scope="module")
def analysis_plan(robot: Robot, cell: Cell) -> AnalysisPlan:
    return build_analysis_plan(robot, AnalysisRequest.model_validate(ANALYSIS | {"step": 15.0}), cell)


def test_poses_run_from_light_to_heavy(analysis_plan: AnalysisPlan, robot: Robot) -> None:
    poses = {sweep.spec.pose[1:] for sweep in analysis_plan.sweeps if sweep.spec.axis == "joint_1"}
    inertia = inertia_rows(robot.chain, 0, np.array([(0.0, *pose) for pose in poses])) @ robot.chain.inertial.ravel()
    assert len(poses) == 6
    assert inertia.max() > 4 * inertia.min()
    assert np.diff(np.sort(np.log(inertia))).max() < 0.5


def test_each_pose_is_swept_to_and_fro_over_the_same_travel_as_the_paper_says(
    analysis_plan: AnalysisPlan, robot: Robot
) -> None:
    assert len(analysis_plan.sweeps) == 2 * 6 * 4
    first = [sweep.spec for sweep in analysis_plan.sweeps[:4]]
    assert [spec.block for spec in first] in (
        ["noise_forward", "noise_backward"] * 2,
        ["noise_backward", "noise_forward"] * 2,
    )
    assert first[0].pose == pytest.approx(first[2].pose)
    assert {spec.excitation for spec in first} == {"noise"}
    commands = [sweep.command() for sweep in analysis_plan.sweeps]
    assert len({one.seed for one in commands if isinstance(one, NoiseCommand)}) == len(analysis_plan.sweeps)
    assert all(sweep.duration > sweep.command().duration for sweep in analysis_plan.sweeps)
    for sweep in analysis_plan.sweeps:
        command = sweep.command()
        assert isinstance(command, NoiseCommand)
        assert 0.85 * 0.01047 < abs(command.offset_velocity) <= 0.010472
        assert 0 < command.effort <= 0.01 * robot.axis(command.joint).rated_effort
        assert command.highest < 40


def test_a_stepped_sine_takes_every_line_in_every_pose(robot: Robot, cell: Cell) -> None:
    wanted = ANALYSIS | {"step": 15.0, "excitation": "stepped_sine", "poses": 2, "repeats": 1}
    sweeps = build_analysis_plan(robot, AnalysisRequest.model_validate(wanted), cell).sweeps
    assert len(sweeps) == 2 * 2 * 4
    for sweep in sweeps:
        assert isinstance(sweep.command(), SweepCommand)
        assert sweep.spec.stepped
        assert not sweep.spec.shows_inertia
    assert sorted(sine.frequency for sweep in sweeps[:4] for sine in sweep.spec.sines) == list(range(1, 17))


COMMAND = NoiseCommand(
    joint="j1",
    offset_velocity=0.01,
    effort=5.0,
    lowest=1.0,
    highest=39.0,
    period=1.6,
    periods=3,
    seed=1,
    softening=0.4,
    ramp=0.5,
    settle=1.0,
    sample_rate=250.0,
    velocity_limit=0.1,
    effort_limit=2000.0,
    position_window=(-0.51, -0.43),
)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"offset_velocity": 0.02}, r"j1: travel .* rad is above the limit"),
        ({"offset_velocity": nan}, "not finite"),
        ({"effort": 0.0}, "effort of the sweep is 0.0"),
        ({"effort": 400.0}, "j1: (travel|predicted peak effort|peak velocity) .* is above the limit"),
        ({"lowest": 0.0}, "lowest frequency of the sweep is 0.0"),
        ({"highest": 0.5}, "width of the band of the sweep is -0.5"),
        ({"sample_rate": 60.0}, "distance of the band from half the sample rate of the sweep is -9.0"),
        ({"softening": 0.0}, "softening of the sweep is 0.0"),
        ({"softening": 1.5}, "softening 1.5 of the gain is above the limit 1"),
        ({"effort_limit": 300.0}, "predicted peak effort"),
        ({"position_window": (-0.501, -0.43)}, "lowest position of the sweep"),
    ],
)
def test_the_envelope_of_a_noise_run(change: dict[str, object], message: str) -> None:
    envelope = Envelope(small_arm(), Cell(name="test", floor=0.0, joint_margin=0.02))
    envelope.check_sweep(COMMAND, (-0.5, 0.3))
    with pytest.raises(EnvelopeViolation, match=message):
        envelope.check_sweep(replace(COMMAND, **change), (-0.5, 0.3))


def test_the_bounds_hold_for_any_phases() -> None:
    rng = np.random.default_rng(1)
    lines, inertia = np.arange(2, 63) / 1.6, 80.0
    time = np.arange(1600) / 1000.0
    for _ in range(20):
        phases = rng.uniform(0, 2 * np.pi, (len(lines), 1))
        waves = np.exp(1j * (2 * np.pi * lines[:, None] * time + phases)) * 5.0 * np.sqrt(2 / len(lines))
        omega = 2 * np.pi * lines[:, None]
        assert np.abs(waves.real.sum(axis=0)).max() <= noise_effort(COMMAND)
        assert np.abs((waves / omega).real.sum(axis=0)).max() / inertia <= noise_velocity(COMMAND, inertia)
        assert np.abs((waves / omega**2).real.sum(axis=0)).max() / inertia <= noise_way(COMMAND, inertia)


def test_a_plan_of_sweeps_stands_on_the_analysis(robot: Robot, cell: Cell) -> None:
    """Lines stay below the resonance that was found, pose by pose."""
    mean = np.array([58.0, 140.0, 60.0, 1 / 7.4e5, 1.2e-3])
    nothing = FrequencyResponse(
        np.array([1.0]), np.ones(1, complex), np.ones(1, complex), np.zeros((1, 2, 2), complex), np.ones(1)
    )
    names = ("inertia", "friction", "locked_rotor", "corner", "frequency")
    figures = {name: {"value": v, "std": 1.0} for name, v in zip(names, (250.0, 200.0, 8.0, 0.2, 2.4), strict=True)}
    ideal = Ideal.model_validate({**figures, "sweep_frequency": 2.0})
    pose = PoseAnalysis((0.0,) * 6, nothing, 192.0, ideal, ideal)
    analyses = {"joint_1": InitialAnalysis(mean, np.diag((0.01 * mean) ** 2), 1.0, (pose,))}
    request = PlanRequest(robot_id=1, axes=("joint_1",), varied=("joint_2", "joint_3"), step=20.0, poses=8, analysis=1)
    found = build_plan(robot, request, cell, analyses)
    for sweep in found.sweeps:
        load = inertia_rows(robot.chain, 0, np.array([sweep.spec.pose]))[0] @ robot.chain.inertial.ravel()
        resonance = np.sqrt(7.4e5 / load) / (2 * np.pi)
        lines = [sine.frequency for sine in sweep.spec.sines]
        assert lines == [line for line in (2.0, 3.0, 4.0, 5.0) if line <= 0.75 * resonance or line == 2.0]
    assert {len(sweep.spec.sines) for sweep in found.sweeps} > {4}


EXPERIMENT = ExperimentRequest(robot_id=1)


NOW = datetime(2026, 1, 1, tzinfo=UTC)


POSE = np.array([[0.0, -0.5, 0.3, 0.0, 0.0, 0.0]])


@pytest.fixture(scope="module")
def diagnosis(robot: Robot, cell: Cell) -> DiagnosisPlan:
    return build_diagnosis_plan(robot, DiagnosisRequest.model_validate(DIAGNOSIS), cell)


def poses_of(diagnosis: DiagnosisPlan, joint: str) -> np.ndarray:
    return np.array(list(dict.fromkeys(sweep.spec.pose for sweep in diagnosis.sweeps if sweep.spec.axis == joint)))


def test_an_axis_hangs_at_clearly_different_angles_or_stands_at_different_positions(
    diagnosis: DiagnosisPlan, robot: Robot
) -> None:
    poses, positions = poses_of(diagnosis, "joint_2"), poses_of(diagnosis, "joint_1")[:, 0]
    gravity = gravity_terms(robot.chain, robot.chain.inertial.ravel(), robot.gravity, 1, poses)[:, 0]
    for different, least in ((gravity, 0.5 * robot.axis("joint_2").rated_effort), (positions, 0.5)):
        assert len(different) == 4
        assert np.diff(np.sort(different)).min() > 0.2 * np.ptp(different)
        assert np.ptp(different) > least


def test_every_block_runs_back_to_back_and_the_first_pose_comes_back(diagnosis: DiagnosisPlan) -> None:
    specs = [sweep.spec for sweep in diagnosis.sweeps if sweep.spec.axis == "joint_2"]
    assert [(spec.block, spec.repeat) for spec in specs[:12]] == [(block, k) for block in BLOCKS for k in (0, 1)]
    assert [spec.block for spec in specs[-4:]] == ["revisit_forward_slow"] * 2 + ["revisit_backward_slow"] * 2
    assert specs[-1].pose == specs[0].pose
    assert {spec.block for spec in specs if not spec.shows_inertia} == {"reversal"}
    assert [spec.id for spec in (sweep.spec for sweep in diagnosis.sweeps)] == [f"{k:04d}" for k in range(1, 105)]
    for before, after in pairwise(specs):
        assert after.started_at > before.started_at


def test_plans_survive_the_store(
    diagnosis: DiagnosisPlan, analysis_plan: AnalysisPlan, robot: Robot, cell: Cell
) -> None:
    designed = full_design(robot, "joint_3", POSE, blocks=("reversal", "wide"))
    for one in (diagnosis, analysis_plan, build_experiment_plan(robot, EXPERIMENT, designed, cell)):
        record = PlanRecord(id=1, robot_id=1, document=json.loads(one.model_dump_json()), created_at=NOW)
        assert plan_of(record) == one


def test_only_wide_and_fast_blocks_may_turn_further() -> None:
    slow = limits(["forward_slow", "reversal"]).travel
    assert limits(["wide"]).travel == pytest.approx(2 * slow)
    assert limits(["wide", "revisit_backward_slow", "backward_fast"]).travel == pytest.approx(3 * slow)


def test_a_pose_whose_sweeps_leave_the_envelope_is_replaced(robot: Robot, cell: Cell) -> None:
    """Where the heaviest poses take more than the axis may give, lighter ones are measured, and it is said."""
    weak = build_robot(robot.description, robot.urdf_text.replace('effort="7000"', 'effort="4000"'))
    request = DiagnosisRequest.model_validate(DIAGNOSIS | {"axes": ("joint_2",), "varied": ("joint_2",)})
    diagnosis = build_diagnosis_plan(weak, request, cell)
    assert len(poses_of(diagnosis, "joint_2")) >= 3
    assert diagnosis.dropped
    assert all("predicted peak effort" in dropped.reason for dropped in diagnosis.dropped)


def test_an_experiment_keeps_order_block_and_repeat(robot: Robot, cell: Cell) -> None:
    designed = full_design(robot, "joint_3", POSE, blocks=("reversal", "wide"), started_at=500.0)
    diagnosis = build_experiment_plan(robot, EXPERIMENT, designed, cell)
    kept, wanted = ([(s.spec.block, s.spec.repeat) for s in sweeps] for sweeps in (diagnosis.sweeps, designed))
    assert kept == wanted
    assert diagnosis.sweeps[0].spec.started_at < 500.0
    assert {sweep.mode for sweep in diagnosis.sweeps} == {SweepMode.DRIVE_SIDE}
    with pytest.raises(BadInput, match="experiment: has no sweeps"):
        build_experiment_plan(robot, EXPERIMENT, (), cell)


def test_a_block_that_leaves_the_envelope_is_left_out_with_its_reason(robot: Robot, cell: Cell) -> None:
    designed = full_design(robot, "joint_3", POSE, blocks=("forward_slow", "wide"))
    diagnosis = build_experiment_plan(robot, EXPERIMENT, [faster(sweep) for sweep in designed], cell)
    assert {sweep.spec.block for sweep in diagnosis.sweeps} == {"forward_slow", "revisit_forward_slow"}
    assert [dropped.reason.split(":")[0] for dropped in diagnosis.dropped] == ["wide"]
    assert "peak velocity" in diagnosis.dropped[0].reason or "travel" in diagnosis.dropped[0].reason
    with pytest.raises(BadInput, match="none of its sweeps can be run; reason for the first: wide: joint_3: travel"):
        build_experiment_plan(robot, EXPERIMENT, [faster(s) for s in designed if s.spec.block == "wide"], cell)


def test_a_mass_that_the_axis_cannot_carry_is_refused_and_kept_for_the_run(robot: Robot, cell: Cell) -> None:
    designed = full_design(robot, "joint_3", POSE, blocks=("forward_slow",))
    heavy, light = (
        EXPERIMENT.model_copy(update={"test_mass": BoltedMass(mass=mass, center=(0.2, 0.0, 0.0))})
        for mass in (800.0, 20.0)
    )
    with pytest.raises(BadInput, match=r"joint_3: predicted peak effort 1\.\d+e\+04 N m is above the limit 3600 N m"):
        build_experiment_plan(robot, heavy, designed, cell)
    diagnosis = build_experiment_plan(robot, light, designed, cell)
    assert diagnosis.request.known_mass == KnownMass(20.0, (0.2, 0.0, 0.0))


def faster(sweep: DesignedSweep) -> DesignedSweep:
    """Of the wide block four times as fast."""
    factor = 4.0 if sweep.spec.block == "wide" else 1.0
    spec = sweep.spec.model_copy(update={"offset_velocity": factor * sweep.spec.offset_velocity})
    return replace(sweep, spec=spec)
