"""Which counterbalance is named: one that is off, one that the robot file lacks, none that pulls like a weight."""

from typing import Any

import numpy as np
import pytest

from service.diagnosis.diagnose import AxisResult, diagnose_axis
from service.diagnosis.verdict import Verdict
from service.model import Robot, RobotDescription, build_robot
from tests.numeric.second_plant.cases import Case, Kind, make
from tests.numeric.second_plant.draft import Draft

pytestmark = pytest.mark.slow

HEALTHY = Case(1, 2001, Kind.NONE, ("counterbalance",), "none")


def on_paper(robot: Robot, joint: str, **changed: Any) -> Robot:
    """The robot file with another counterbalance; None: with none."""
    description = robot.description.model_dump(mode="json")
    axis = next(axis for axis in description["axes"] if axis["joint"] == joint)
    axis["counterbalance"] = None if changed.get("force", 0.0) is None else axis["counterbalance"] | changed
    return build_robot(RobotDescription.model_validate(description), robot.urdf_text)


def diagnosed(share: float | None, **more: Any) -> AxisResult:
    """A machine whose robot file has `share` more force than its counterbalance; None: no counterbalance."""
    robot, joint, sweeps, _ = make(HEALTHY, small=True, **more)
    own = robot.axis(joint).counterbalance
    assert own is not None
    changed = {"force": None} if share is None else {"force": (1 + share) * own.force, "rate": (1 + share) * own.rate}
    return diagnose_axis(on_paper(robot, joint, **changed), joint, sweeps, twin=share is not None)


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
    """A spring of free length 0 pulls as A cos q + B sin q: half of its rate is a weight somewhere else."""
    robot, joint, sweeps, truth = make(HEALTHY, small=True, change=_weightlike)
    own = robot.axis(joint).counterbalance
    assert own is not None
    spring = {"force": 400.0 * own.length, "rate": 400.0, "column": None}
    found = diagnose_axis(on_paper(robot, joint, **spring), joint, sweeps, twin=False)
    assert found.verdict is Verdict.AMBIGUOUS
    assert {"counterbalance", "gravity_error"} <= set(found.candidates)


def _weightlike(draft: Draft) -> None:
    """The machine without counterbalance."""
    draft.train.gravity = draft.curve(draft.built)


def test_one_that_the_robot_file_lacks_is_named() -> None:
    found = diagnosed(None)
    assert [effect.name for effect in found.effects] == ["counterbalance"]
    assert found.verdict is Verdict.NAMED
    assert np.isfinite([one.value for one in found.effects[0].parameters.values()]).all()
