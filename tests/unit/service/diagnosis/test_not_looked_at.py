"""Two sweeps of one direction, as the page plans them: what they cannot show is never called none."""

import numpy as np
import pytest

from service.diagnosis import axis_document, diagnose_axis
from service.identification.design.diagnosis_sweeps import BLOCKS, REVISITED, full_design, paper_design
from service.results.diagnosis import AxisDiagnosis, standing_of
from tests.numeric.campaign import max100
from tests.unit.service.diagnosis.following import RATE, following

pytestmark = pytest.mark.slow

JOINT = "joint_2"
POSES = np.array([[0.0, -0.8, 0.3, 0, 0, 0], [0.0, 0.9, 0.9, 0, 0, 0], [0.0, 0.1, -0.4, 0, 0, 0]])


def found(blocks: tuple[str, ...] | None, repeats: int = 1, poses: int = 2) -> AxisDiagnosis:
    """The diagnosis of a machine with nothing but rigid bodies; `blocks`: None for the design of the paper."""
    robot, measured = max100(), POSES[:poses]
    designed = (
        paper_design(robot, JOINT, measured, sample_rate=RATE)
        if blocks is None
        else full_design(robot, JOINT, measured, blocks=blocks, repeats=repeats, sample_rate=RATE, revisit=False)
    )
    sweeps = following(robot, JOINT, designed, noise=0.002)
    return AxisDiagnosis.read(axis_document(diagnose_axis(robot, JOINT, sweeps, twin=False)), JOINT)


def test_two_sweeps_of_one_direction_show_nothing() -> None:
    axis = found(None)
    assert (axis.verdict, axis.standing) == ("untestable", "open")
    assert axis.gap.noise_floor_rms is None
    assert "coulomb_friction" in axis.biasing
    assert set(axis.biasing) <= set(axis.untestable)
    assert "no noise floor" in axis.summary
    assert "is noise" not in axis.summary
    assert axis.next_experiment is not None


def test_repeats_alone_do_not_make_one_direction_conclusive() -> None:
    axis = found(("forward_slow",), repeats=2)
    assert axis.gap.noise_floor_rms is not None
    assert "coulomb_friction" in axis.biasing
    assert (axis.verdict, axis.standing) == ("untestable", "open")
    assert "would change the estimate unseen" in axis.summary


@pytest.mark.parametrize(
    ("repeats", "poses", "verdict", "biasing", "kind"),
    [
        (1, 3, "untestable", (), None),
        (2, 2, "untestable", ("hose_spring",), "more_poses"),  # two poses do not show a hose
        (2, 3, "none", (), None),
    ],
)
def test_all_blocks_settle_it_where_they_are_repeated_in_enough_poses(
    repeats: int, poses: int, verdict: str, biasing: tuple[str, ...], kind: str | None
) -> None:
    axis = found(BLOCKS, repeats=repeats, poses=poses)
    assert (axis.verdict, axis.biasing) == (verdict, biasing)
    if verdict == "none":
        assert axis.standing == standing_of(axis) == "settled"
        return
    assert axis.next_experiment is not None
    assert kind in (None, axis.next_experiment.kind)
    assert repeats > 1 or axis.next_experiment.blocks == tuple(REVISITED)
