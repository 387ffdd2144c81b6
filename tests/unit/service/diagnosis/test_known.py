"""Effects that the model has already: fitted with the base, and compared with what the model says of them."""

from dataclasses import replace

import numpy as np
import pytest

from service.diagnosis import axis_document, diagnose_axis
from service.diagnosis.effects import CATALOGUE
from service.diagnosis.fit.equations import Term
from service.diagnosis.fit.parameters import Parameter
from service.recording import Sweep
from tests.numeric.campaign import max100
from tests.unit.service.diagnosis.following import swept

pytestmark = pytest.mark.slow

POSES = np.array(
    [[0.0, -0.8, 0.3, 0, 0, 0], [0.0, 0.9, 0.9, 0, 0, 0], [0.0, 0.1, -0.4, 0, 0, 0]]
)  # two do not show a hose
BLOCKS = ("forward_slow", "backward_slow", "forward_fast")


def sweeps_of(joint: str, coulomb: float, seed: int) -> list[Sweep]:
    return swept(joint, POSES, {Term("coulomb_friction"): (coulomb,)}, seed=seed, blocks=BLOCKS)


@pytest.mark.parametrize("seed", [3, 4])
def test_a_known_effect_that_has_changed_is_told_and_one_that_has_not_is_right(seed: int) -> None:
    known = {"coulomb_friction": {"coulomb": Parameter(40.0, 0.2, "N m")}}
    sweeps = sweeps_of("joint_2", 120.0, seed)
    found = axis_document(diagnose_axis(max100(), "joint_2", sweeps, known=known, twin=False))
    assert (found["verdict"], found["effects"]) == ("none", [])
    (change,) = found["changes"]
    assert (change["effect"], change["parameter"], change["model"]["value"]) == ("coulomb_friction", "coulomb", 40.0)
    assert abs(change["now"]["value"] - 120.0) < 3 * change["now"]["std"]
    assert "Coulomb friction has changed: coulomb is 1" in found["summary"]
    assert ", not 40 N m" in found["summary"]
    assert "the model is right" not in found["summary"]
    right = {"coulomb_friction": {"coulomb": Parameter(120.0, 0.5, "N m")}}
    found = axis_document(diagnose_axis(max100(), "joint_2", sweeps, known=right, twin=False))
    assert (found["verdict"], found["changes"]) == ("none", [])
    assert "the model is right" in found["summary"]


def test_what_the_axis_cannot_have_is_left_out() -> None:
    """`--known` is about all axes; a motor of which the robot file knows no orders cannot cog."""
    robot = max100()
    axes = tuple(axis.model_copy(update={"cogging_orders": ()}) for axis in robot.axes)
    smooth = replace(robot, description=robot.description.model_copy(update={"axes": axes}))
    found = diagnose_axis(smooth, "joint_1", sweeps_of("joint_1", 60.0, 6), known={"cogging_torque": {}}, twin=False)
    assert [effect.name for effect in found.effects] == ["coulomb_friction"]
    assert found.known == ()
    assert "cogging_torque" not in found.untestable


@pytest.mark.slow
def test_all_effects_may_be_known() -> None:
    found = diagnose_axis(
        max100(), "joint_2", sweeps_of("joint_2", 60.0, 7), known={name: {} for name in CATALOGUE}, twin=False
    )
    assert found.effects == ()
