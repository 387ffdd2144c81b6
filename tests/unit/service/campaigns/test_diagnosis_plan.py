"""Plan of a diagnosis: poses that hang differently, all blocks in each, and what becomes of one that does not fit."""

import json
from dataclasses import replace
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from drivers.ports import SweepMode
from service.identification.design.diagnosis_sweeps import BLOCKS, DesignedSweep, full_design
from service.identification.estimates.torque_gain import KnownMass
from service.identification.model.regressor import gravity_terms
from service.model.configuration import Cell, read_cell
from service.model.errors import BadInput
from service.model.robot import Robot, build_robot
from service.planning.compiled_plan import plan_of
from service.planning.diagnosis import build_diagnosis_plan, build_experiment_plan
from service.planning.documents import DiagnosisPlan, DiagnosisRequest, ExperimentRequest, limits
from service.planning.safety.envelope import Envelope
from service.store.documents import BoltedMass, PlanRecord

REQUEST = {"kind": "diagnosis", "robot_id": 1, "axes": ("joint_1", "joint_2"), "varied": ("joint_1", "joint_2")}
EXPERIMENT = ExperimentRequest(robot_id=1)
NOW = datetime(2026, 1, 1, tzinfo=UTC)
POSE = np.array([[0.0, -0.5, 0.3, 0.0, 0.0, 0.0]])


@pytest.fixture(scope="module")
def cell(root: Path) -> Cell:
    return read_cell(root / "config/cells/workshop.yaml")


@pytest.fixture(scope="module")
def plan(robot: Robot, cell: Cell) -> DiagnosisPlan:
    return build_diagnosis_plan(robot, DiagnosisRequest.model_validate(REQUEST), cell)


def poses_of(plan: DiagnosisPlan, joint: str) -> np.ndarray:
    return np.array(list(dict.fromkeys(sweep.spec.pose for sweep in plan.sweeps if sweep.spec.axis == joint)))


def test_an_axis_with_weight_hangs_at_clearly_different_angles(plan: DiagnosisPlan, robot: Robot) -> None:
    poses = poses_of(plan, "joint_2")
    chain = robot.chain
    gravity = gravity_terms(chain, chain.inertial.ravel(), robot.gravity, 1, poses)[:, 0]
    assert len(poses) == 4
    assert np.diff(np.sort(gravity)).min() > 0.2 * np.ptp(gravity)
    assert np.ptp(gravity) > 0.5 * robot.axis("joint_2").rated_effort


def test_an_axis_without_weight_stands_at_clearly_different_positions(plan: DiagnosisPlan) -> None:
    positions = np.sort(poses_of(plan, "joint_1")[:, 0])
    assert len(positions) == 4
    assert np.diff(positions).min() > 0.2 * np.ptp(positions) > 0.5


def test_every_block_runs_back_to_back_and_the_first_pose_comes_back(plan: DiagnosisPlan) -> None:
    specs = [sweep.spec for sweep in plan.sweeps if sweep.spec.axis == "joint_2"]
    assert [(spec.block, spec.repeat) for spec in specs[:12]] == [(block, k) for block in BLOCKS for k in (0, 1)]
    assert [spec.block for spec in specs[-4:]] == ["revisit_forward_slow"] * 2 + ["revisit_backward_slow"] * 2
    assert specs[-1].pose == specs[0].pose
    assert [spec.id for spec in (sweep.spec for sweep in plan.sweeps)] == [f"{k:04d}" for k in range(1, 105)]
    for before, after in pairwise(specs):
        assert after.started_at > before.started_at


def test_what_reverses_takes_no_part_in_the_inertia(plan: DiagnosisPlan) -> None:
    assert {sweep.spec.block for sweep in plan.sweeps if not sweep.spec.shows_inertia} == {"reversal"}


@pytest.mark.slow
def test_the_envelope_knows_every_sweep_on_its_way(plan: DiagnosisPlan, robot: Robot, cell: Cell) -> None:
    envelope = Envelope(robot, cell, plan.limits)
    here = list(cell.home_pose(robot.joints))
    for sweep in plan.sweeps:
        for leg in sweep.legs:
            envelope.check_move(leg.joint, here, leg.target, 0.1)
            here[robot.index(leg.joint)] = leg.target
        assert here == pytest.approx(sweep.spec.pose, abs=2e-4)
        here = list(sweep.spec.pose)
        envelope.check_sweep(sweep.command(), here)
        way = sweep.spec.offset_velocity * (sweep.spec.measure_from + (sweep.spec.periods or 0))
        here[robot.index(sweep.spec.axis)] += way
    assert plan.dropped == ()


def test_plans_survive_the_store(plan: DiagnosisPlan, robot: Robot, cell: Cell) -> None:
    designed = full_design(robot, "joint_3", POSE, blocks=("reversal", "wide"))
    for one in (plan, build_experiment_plan(robot, EXPERIMENT, designed, cell)):
        record = PlanRecord(id=1, robot_id=1, document=json.loads(one.model_dump_json()), created_at=NOW)
        assert plan_of(record) == one


def test_only_wide_and_fast_blocks_may_turn_further() -> None:
    slow = limits(["forward_slow", "reversal"]).travel
    assert limits(["wide"]).travel == pytest.approx(2 * slow)
    assert limits(["wide", "revisit_backward_slow", "backward_fast"]).travel == pytest.approx(3 * slow)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"blocks": ("forward_slow", "sideways")}, "blocks: unknown block sideways; there are forward_slow"),
        ({"blocks": ("wide", "wide")}, "blocks: names a block twice"),
        ({"axes": ("joint_9",)}, "axes: unknown joint joint_9"),
        ({"poses": 90, "step": 60.0}, "poses: 90 requested, but of"),
    ],
)
def test_what_cannot_be_met_names_its_field(robot: Robot, cell: Cell, change: dict[str, object], message: str) -> None:
    with pytest.raises(BadInput, match=message):
        build_diagnosis_plan(robot, DiagnosisRequest.model_validate(REQUEST | change), cell)


def test_a_pose_whose_sweeps_leave_the_envelope_is_replaced(robot: Robot, cell: Cell) -> None:
    """Where the heaviest poses take more than the axis may give, lighter ones are measured, and it is said."""
    weak = build_robot(robot.description, robot.urdf_text.replace('effort="7000"', 'effort="4000"'))
    request = DiagnosisRequest.model_validate(REQUEST | {"axes": ("joint_2",), "varied": ("joint_2",)})
    plan = build_diagnosis_plan(weak, request, cell)
    assert len(poses_of(plan, "joint_2")) >= 3
    assert plan.dropped
    assert all("predicted peak effort" in dropped.reason for dropped in plan.dropped)


def test_an_experiment_keeps_order_block_and_repeat(robot: Robot, cell: Cell) -> None:
    designed = full_design(robot, "joint_3", POSE, blocks=("reversal", "wide"), started_at=500.0)
    plan = build_experiment_plan(robot, EXPERIMENT, designed, cell)
    assert [(s.spec.block, s.spec.repeat) for s in plan.sweeps] == [(s.spec.block, s.spec.repeat) for s in designed]
    assert plan.sweeps[0].spec.started_at < 500.0
    assert {sweep.mode for sweep in plan.sweeps} == {SweepMode.DRIVE_SIDE}


def test_a_block_that_leaves_the_envelope_is_left_out_with_its_reason(robot: Robot, cell: Cell) -> None:
    designed = full_design(robot, "joint_3", POSE, blocks=("forward_slow", "wide"))
    plan = build_experiment_plan(robot, EXPERIMENT, [faster(sweep) for sweep in designed], cell)
    assert {sweep.spec.block for sweep in plan.sweeps} == {"forward_slow", "revisit_forward_slow"}
    assert [dropped.reason.split(":")[0] for dropped in plan.dropped] == ["wide"]
    assert "peak velocity" in plan.dropped[0].reason or "travel" in plan.dropped[0].reason
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
    plan = build_experiment_plan(robot, light, designed, cell)
    assert plan.request.known_mass == KnownMass(20.0, (0.2, 0.0, 0.0))


def test_an_experiment_without_sweeps_is_none(robot: Robot, cell: Cell) -> None:
    with pytest.raises(BadInput, match="experiment: has no sweeps"):
        build_experiment_plan(robot, EXPERIMENT, (), cell)


def faster(sweep: DesignedSweep) -> DesignedSweep:
    """Of the wide block four times as fast."""
    factor = 4.0 if sweep.spec.block == "wide" else 1.0
    spec = sweep.spec.model_copy(update={"offset_velocity": factor * sweep.spec.offset_velocity})
    return replace(sweep, spec=spec)
