"""Which sweeps are evidence."""

from dataclasses import replace

import numpy as np
import pytest

from service.diagnosis import axis_document, diagnose_axis
from service.diagnosis.design import full_design
from service.diagnosis.equations import Term
from service.errors import BadInput
from service.recording import Sweep
from tests.numeric.campaign import max100
from tests.unit.service.diagnosis.following import RATE, following

POSES = np.array([[0.0, -0.8, 0.3, 0, 0, 0], [0.0, 0.9, 0.9, 0, 0, 0]])
JOINT = "joint_2"


def held(sweep: Sweep, effort: float) -> Sweep:
    """The axis at standstill in the pose of a sweep, dry friction holding what the drive does not."""
    spec = sweep.spec.model_copy(
        update={"id": "held", "excitation": "standstill", "offset_velocity": 0.0, "sines": (), "block": "hold"}
    )
    recording = sweep.recording
    still = replace(
        recording,
        effort=np.full_like(recording.effort, effort),
        velocity=np.zeros_like(recording.velocity),
        position=np.full_like(recording.position, recording.position[0]),
    )
    return Sweep(spec, still)


def test_an_axis_that_holds_tells_nothing_of_its_torque() -> None:
    robot = max100()
    designed = full_design(robot, JOINT, POSES, blocks=("forward_slow", "backward_slow"), sample_rate=RATE)
    sweeps = following(robot, JOINT, designed, {Term("coulomb_friction"): (60.0,)})
    moving = axis_document(diagnose_axis(robot, JOINT, sweeps))
    with_rest = axis_document(diagnose_axis(robot, JOINT, [*sweeps, held(sweeps[0], 500.0), held(sweeps[4], -500.0)]))
    assert [effect["effect"] for effect in moving["effects"]] == ["coulomb_friction"]
    assert with_rest == moving


def test_holding_alone_is_no_evidence() -> None:
    robot = max100()
    designed = full_design(robot, JOINT, POSES, blocks=("forward_slow",), sample_rate=RATE)
    with pytest.raises(BadInput, match=f"{JOINT}.*has no sweep that moves"):
        diagnose_axis(robot, JOINT, [held(following(robot, JOINT, designed)[0], 0.0)])
