"""The sweeps of a diagnosis: which blocks, in which order, and that none leaves its bounds."""

from itertools import pairwise

import numpy as np

from service.identification.design.diagnosis_sweeps import (
    BLOCKS,
    FAST,
    ROOM,
    full_design,
    is_partial,
    machine_time,
    measured_blocks,
    other_poses,
    paper_design,
)
from service.identification.design.excitation import Excitation, velocity_setpoint
from tests.numeric.campaign import max100

POSES = np.array([[0.0, -0.8, 0.3, 0, 0, 0], [0.0, 0.0, -0.5, 0, 0, 0], [0.0, 0.9, 0.9, 0, 0, 0]])
TRAVEL = float(np.radians(4.0))


def test_every_block_twice_back_to_back_and_the_first_pose_once_more() -> None:
    designed = full_design(max100(), "joint_2", POSES)
    labels = [(sweep.spec.block, sweep.spec.repeat) for sweep in designed]
    assert labels[: 2 * len(BLOCKS)] == [(block, repeat) for block in BLOCKS for repeat in (0, 1)]
    assert [block for block, _ in labels[-4:]] == ["revisit_forward_slow"] * 2 + ["revisit_backward_slow"] * 2
    assert designed[-1].spec.pose == designed[0].spec.pose
    assert len(designed) == 2 * len(BLOCKS) * len(POSES) + 4


def test_sweeps_follow_one_another_in_time() -> None:
    designed = full_design(max100(), "joint_1", POSES)
    for before, after in pairwise(designed):
        assert after.spec.started_at > before.spec.started_at + before.duration


def test_only_reversal_reverses_and_travel_stays_small() -> None:
    for sweep in full_design(max100(), "joint_3", POSES[:1]):
        spec = sweep.spec
        excitation = Excitation(
            spec.offset_velocity, spec.sines, spec.period or 1.0, spec.periods or 1, sweep.ramp, sweep.settle
        )
        velocity = velocity_setpoint(excitation, np.arange(0, sweep.duration, 0.001))
        assert (velocity.min() >= -1e-12 or velocity.max() <= 1e-12) == (spec.block != "reversal")
        assert abs(np.sum(velocity) * 0.001) <= 1.01 * FAST * TRAVEL
        assert spec.measure_from == sweep.ramp + sweep.settle


def test_the_paper_goes_one_way_once() -> None:
    designed = paper_design(max100(), "joint_2", POSES)
    assert [(s.spec.block, s.spec.repeat) for s in designed] == [("forward_slow", 0)] * 3
    assert {sine.frequency for s in designed for sine in s.spec.sines} == {2.0, 3.0, 4.0, 5.0}


def test_blocks_are_told_by_what_the_sweeps_are() -> None:
    robot = max100()
    specs = [
        one.spec.model_copy(update={"block": "of another day"}) for one in full_design(robot, "joint_2", POSES[:1])
    ]
    assert measured_blocks(specs) == set(BLOCKS)
    assert not is_partial(specs)
    paper = [one.spec for one in paper_design(robot, "joint_2", POSES)]
    assert measured_blocks(paper) == {"forward_slow"}
    assert is_partial(paper)
    record = paper[0].model_copy(update={"excitation": "trajectory", "sines": ()})
    assert (measured_blocks([record]), is_partial([record])) == (set(), False)


def test_other_poses_are_new_and_have_room() -> None:
    robot = max100()
    poses = other_poses(robot, "joint_2", POSES)
    assert len(poses) > 4
    assert np.abs(poses[:, None] - POSES).max(axis=2).min() > 0.1
    np.testing.assert_array_equal(poses[:, 0], 0.0)  # what lies before the axis turns nothing
    limits = np.array([(joint.lower, joint.upper) for joint in robot.chain.joints])
    moved = poses != 0
    assert ((poses >= limits[:, 0] + ROOM) | ~moved).all()
    assert ((poses <= limits[:, 1] - ROOM) | ~moved).all()


def test_machine_time_counts_the_way_back() -> None:
    designed = full_design(max100(), "joint_2", POSES[:1], blocks=("forward_slow",), revisit=False)
    assert machine_time(designed) > sum(sweep.duration for sweep in designed) + 2 * 2.0
