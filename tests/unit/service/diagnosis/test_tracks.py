"""Which sweeps are evidence."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from service import BadInput
from service.diagnosis import axis_document, diagnose_axis
from service.diagnosis.fit.equations import Term, grouped
from service.diagnosis.rows.signals import tracks
from service.model import Sweep
from tests.numeric.campaign import max100
from tests.unit.service.diagnosis.following import FORWARD, SLOW, swept

pytestmark = pytest.mark.slow

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
    sweeps = swept(JOINT, POSES, {Term("coulomb_friction"): (60.0,)}, blocks=SLOW)
    moving = axis_document(diagnose_axis(robot, JOINT, sweeps))
    with_rest = axis_document(diagnose_axis(robot, JOINT, [*sweeps, held(sweeps[0], 500.0), held(sweeps[4], -500.0)]))
    assert [effect.effect for effect in moving.effects] == ["coulomb_friction"]
    assert with_rest == moving


def relabelled(sweeps: Sequence[Sweep], **changes: object) -> list[Sweep]:
    return [replace(sweep, spec=sweep.spec.model_copy(update=changes)) for sweep in sweeps]


def test_repeats_are_what_moved_alike_whatever_its_label() -> None:
    """A CNC's own traces have no blocks: forward, fast and wide sweeps of one pose are no repeats of one another."""
    robot, sweeps = max100(), swept(JOINT, POSES)
    for label in ("", "mine"):  # one label makes no repeats of two motions
        groups = grouped(tracks(robot, JOINT, relabelled(sweeps, block=label)))
        assert sum(len(group.pieces) for group in groups) == len(sweeps)
        for group in groups:
            motions = {sweeps[piece.sweep].spec.block.removeprefix("revisit_") for piece in group.pieces}
            assert (len(motions), len(group.pieces) > 1) == (1, True)
    assert diagnose_axis(robot, JOINT, relabelled(sweeps, block=""), twin=False).verdict.value == "none"


def test_poses_that_differ_by_less_than_anybody_can_command_are_one() -> None:
    robot = max100()
    jittering = [
        replace(sweep, spec=sweep.spec.model_copy(update={"pose": tuple(p + 1e-6 * k for p in sweep.spec.pose)}))
        for k, sweep in enumerate(swept(JOINT, POSES, blocks=FORWARD, revisit=False))
    ]
    found = tracks(robot, JOINT, jittering)
    assert len(found.poses) == len(POSES)
    assert {len(group.pieces) for group in grouped(found)} == {2}


def test_a_trajectory_of_several_axes_is_no_evidence() -> None:
    robot, sweeps = max100(), swept(JOINT, POSES, blocks=FORWARD)
    beside = relabelled(sweeps[:1], id="all", excitation="trajectory", block="trajectory 1 of 2 axes")
    shaken = [replace(one, recording=replace(one.recording, effort=one.recording.effort + 300.0)) for one in beside]
    assert axis_document(diagnose_axis(robot, JOINT, [*sweeps, *shaken])) == axis_document(
        diagnose_axis(robot, JOINT, sweeps)
    )


def dead(sweeps: Sequence[Sweep], channel: str) -> list[Sweep]:
    return [replace(one, recording=replace(one.recording, **{channel: 0 * one.recording.time})) for one in sweeps]


NO_EVIDENCE: list[tuple[Callable[[list[Sweep]], list[Sweep]], str]] = [
    (lambda sweeps: dead(sweeps, "velocity"), f"{JOINT}.*velocity is 0 in every sample"),
    (lambda sweeps: dead(sweeps, "effort"), f"{JOINT}.*effort is 0 in every sample"),
    (lambda sweeps: [held(sweeps[0], 0.0)], f"{JOINT}.*has no sweep that moves"),
    (
        lambda sweeps: relabelled(sweeps[:1], excitation="trajectory", sines=(), period=100.0),
        r"period of 100 s is longer than its \d",
    ),
]


@pytest.mark.parametrize(("change", "words"), NO_EVIDENCE)
def test_what_is_no_evidence_is_told(change: Callable[[list[Sweep]], list[Sweep]], words: str) -> None:
    sweeps = swept(JOINT, POSES[:1], blocks=FORWARD)
    with pytest.raises(BadInput, match=words):
        diagnose_axis(max100(), JOINT, change(sweeps))
