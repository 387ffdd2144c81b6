"""Which counterbalance is named: one that is off, one that the robot file lacks, none that pulls like a weight."""

from typing import Any

import pytest

from service.diagnosis.diagnose import AxisResult, diagnose_axis
from service.diagnosis.verdict import Verdict
from service.model import Robot, RobotDescription, build_robot
from tests.numeric.second_plant.cases import Case, Kind, make
from tests.numeric.second_plant.draft import Draft

pytestmark = pytest.mark.slow

HEALTHY = Case(1, 2001, Kind.NONE, ("counterbalance",), "none")


def on_paper(robot: Robot, joint: str, **changed: Any) -> Robot:
    """The robot file with another counterbalance."""
    description = robot.description.model_dump(mode="json")
    axis = next(axis for axis in description["axes"] if axis["joint"] == joint)
    axis["counterbalance"] |= changed
    return build_robot(RobotDescription.model_validate(description), robot.urdf_text)


def diagnosed(share: float) -> AxisResult:
    """A machine whose robot file has `share` more force than its counterbalance."""
    robot, joint, sweeps, _ = make(HEALTHY, small=True)
    own = robot.axis(joint).counterbalance
    assert own is not None
    changed = {"force": (1 + share) * own.force, "rate": (1 + share) * own.rate}
    return diagnose_axis(on_paper(robot, joint, **changed), joint, sweeps)


def test_the_right_one_is_no_finding() -> None:
    assert diagnosed(0.0).verdict is Verdict.NONE


def test_one_that_is_off_is_named_with_its_share() -> None:
    found = diagnosed(1.0)
    assert found.verdict is Verdict.NAMED
    (effect,) = found.effects
    assert effect.name == "counterbalance"
    share = effect.parameters["share"]
    assert abs(share.value + 0.5) < 3 * share.std + 0.02
    assert found.gap.twin_rms is not None
    assert found.gap.twin_rms < 1.3 * (found.gap.noise_floor_rms or 0.0)


def test_one_that_pulls_like_a_weight_is_not_told_apart_from_one() -> None:
    """A spring of free length 0 pulls as A cos q + B sin q. The machine lacks it, or has a weight somewhere else."""
    robot, joint, sweeps, _ = make(HEALTHY, change=_without)
    own = robot.axis(joint).counterbalance
    assert own is not None
    spring = {"force": 3000.0 * own.length, "rate": 3000.0, "column": None}
    found = diagnose_axis(on_paper(robot, joint, **spring), joint, sweeps, twin=False)
    assert found.verdict is Verdict.AMBIGUOUS
    assert {"counterbalance", "gravity_error"} <= set(found.candidates)


def _without(draft: Draft) -> None:
    """The machine without counterbalance."""
    draft.train.gravity = draft.curve(draft.built)


def test_one_that_the_robot_file_lacks_is_named() -> None:
    robot, joint, sweeps, _ = make(Case(6, 30_000, Kind.SINGLE, ("counterbalance",), "large"))
    assert robot.axis(joint).counterbalance is None
    found = diagnose_axis(robot, joint, sweeps, twin=False)
    assert found.verdict is Verdict.NAMED
    assert [effect.name for effect in found.effects] == ["counterbalance"]
