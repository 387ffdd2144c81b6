"""Budgets and criteria of a plan, on the small arm: so many poses, so much time, or so much confidence."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from drivers.ports import SweepCommand
from service import BadInput, EnvelopeViolation
from service.identification.design.pose_selection import Criterion, PoseLimits
from service.model import Robot, build_robot
from service.model.configuration import Cell, read_cell, read_robot
from service.planning.documents import PlanDocument, PlanRequest
from service.planning.plan import build_plan
from service.planning.safety.envelope_check import Envelope
from tests.unit.service.campaigns.small_arm import small_arm

pytestmark = pytest.mark.slow

CONFIG = Path(__file__).parents[4] / "config"
CELL = Cell(name="plain", floor=0.0)
TRAVEL_AND_NOT = (Criterion.CONDITION_AND_TRAVEL, Criterion.CONDITION)


def request(**budget: object) -> PlanRequest:
    fields = {"robot_id": 1, "axes": ("j1", "j2"), "varied": ("j1", "j2"), "step": 20.0} | budget
    return PlanRequest.model_validate(fields)


def plan(**budget: object) -> PlanDocument:
    return build_plan(small_arm(), request(**budget), CELL)


def known_to(inertia: float) -> Robot:
    """The arm with a CAD model whose inertias are known to this share."""
    description = small_arm().description
    prior = description.prior.model_copy(update={"inertia": inertia})
    return build_robot(description.model_copy(update={"prior": prior}), small_arm().urdf_text)


@pytest.fixture(scope="module")
def all_poses() -> PlanDocument:
    document = plan(poses=60)
    assert len(document.condition) == len(document.confidence) == 60
    return document


def finite(values: tuple[float | None, ...]) -> list[float]:
    return [value for value in values if value is not None]


def test_confidence_is_told_after_each_pose_and_only_grows(all_poses: PlanDocument) -> None:
    told = finite(all_poses.confidence)
    assert all_poses.confidence[0] is None
    assert told == sorted(told, reverse=True)
    assert 0 < told[-1] < told[0]


def test_poses_that_add_nothing_are_named(all_poses: PlanDocument) -> None:
    assert all_poses.spare
    poses = {sweep.spec.pose for sweep in all_poses.sweeps} | {one.pose for one in all_poses.dropped}
    for spare in all_poses.spare:
        before, after = all_poses.confidence[spare.number - 2 : spare.number]
        assert before is not None
        assert after is not None
        assert after > before * (1 - 0.05 / (spare.number - 1))
        assert spare.pose in poses


def test_a_confidence_is_not_reached_while_the_estimate_would_state_none() -> None:
    """The sweeps of three poses give 3 % but are not better than the CAD model in every direction."""
    alone, document = plan(confidence=3.0), build_plan(known_to(0.03), request(confidence=3.0), CELL)
    assert build_plan(known_to(0.03), request(poses=len(alone.confidence)), CELL).undetermined
    assert len(document.confidence) > len(alone.confidence)
    assert finite(document.confidence)[-1] <= 3.0
    assert (document.undetermined, document.enough_poses) == ((), None)
    assert len(document.condition) == len(document.confidence)


def test_a_confidence_that_the_estimate_cannot_state_names_parameters_and_axes() -> None:
    with pytest.raises(
        BadInput,
        match=r"confidence: 3 % requested, but the best (\d+) of \1 measurable poses are not better than CAD for "
        r"mx\(fore\), mz\(fore\), so the estimate would state no confidence of J; J of j1 depends on them",
    ):
        build_plan(known_to(0.003), request(confidence=3.0), CELL)


def test_a_pose_that_cannot_be_swept_is_no_part_of_the_promise(monkeypatch: pytest.MonkeyPatch) -> None:
    closed = plan(confidence=2.0).sweeps[-1].spec.pose
    check = Envelope.check_sweep

    def refuse(envelope: Envelope, command: SweepCommand, pose: Sequence[float]) -> None:
        if tuple(pose) == closed:
            raise EnvelopeViolation("closed")
        check(envelope, command, pose)

    monkeypatch.setattr(Envelope, "check_sweep", refuse)
    document = plan(confidence=2.0)
    assert [one.pose for one in document.dropped] == [closed]
    assert len(document.confidence) == len({sweep.spec.pose for sweep in document.sweeps})
    assert finite(document.confidence)[-1] <= 2.0


@pytest.mark.parametrize("duration", [120.0, 600.0])
def test_a_budget_of_time_is_kept_and_used(duration: float) -> None:
    document = plan(duration=duration)
    assert document.duration <= duration
    longest = max(
        sum(sweep.duration for sweep in document.sweeps[k : k + 2]) for k in range(0, len(document.sweeps), 2)
    )
    assert document.duration > duration - 2 * longest
    assert len(document.condition) == len(document.confidence) == len(document.sweeps) / 2


def test_a_plan_from_before_it_named_what_stays_undetermined_is_read() -> None:
    stored = plan(poses=3).model_dump(mode="json")
    del stored["undetermined"], stored["enough_poses"]
    read = PlanDocument.model_validate(stored)
    assert (read.undetermined, read.enough_poses) == ((), None)


def test_travel_buys_a_shorter_way_with_a_little_condition() -> None:
    """24 poses of the MAX 100 class robot, on a grid so fine that the poses lost at an obstacle hardly matter."""
    robot, cell = read_robot(CONFIG / "robots/max100-class.yaml"), read_cell(CONFIG / "cells/workshop.yaml")
    joints = {"axes": ("joint_1", "joint_2", "joint_3"), "varied": ("joint_2", "joint_3"), "step": 2.5}
    near, best = (build_plan(robot, request(criterion=criterion, **joints), cell) for criterion in TRAVEL_AND_NOT)

    def way(document: PlanDocument) -> float:
        poses = np.array([(0.0,) * 6, *dict.fromkeys(sweep.spec.pose for sweep in document.sweeps)])
        return float(np.abs(np.diff(poses, axis=0)).sum())

    assert way(near) < 0.85 * way(best)
    assert near.condition[-1] is not None
    assert best.condition[-1] is not None
    assert near.condition[-1] < PoseLimits.slack**4 * best.condition[-1]
