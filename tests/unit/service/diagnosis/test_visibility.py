"""What designs can show, which of the missing blocks would, and that what they cannot is never called none."""

import numpy as np
import pytest

from service.diagnosis import axis_document, diagnose_axis
from service.diagnosis.effects import CATALOGUE
from service.diagnosis.fit.equations import Term, applies
from service.diagnosis.sensitivity import UntestableEffect, untestable
from service.identification.design.diagnosis_sweeps import BLOCKS, REVISITED, full_design, paper_design
from service.model.results.diagnosis import AxisDiagnosis, standing_of
from tests.numeric.campaign import max100
from tests.unit.service.diagnosis.following import FORWARD, RATE, equations_of, following, known_to, swept

pytestmark = pytest.mark.slow

POSES = np.array([[0.0, -0.8, 0.3, 0, 0, 0], [0.0, 0.9, 0.9, 0, 0, 0]])


def unseen(joint: str, blocks: tuple[str, ...], *names: str, noise: float = 0.005) -> dict[str, tuple[str, ...]]:
    """The blocks that would show them."""
    robot = max100()
    sweeps = swept(joint, POSES, noise=noise, blocks=blocks, revisit=False)
    found = untestable(equations_of(robot, joint, sweeps), names, sweeps)
    return {name: one.blocks for name, one in found.items()}


def test_slow_sweeps_cannot_show_what_needs_high_frequencies() -> None:
    found = unseen("joint_3", ("forward_slow",), "measurement_delay", "coulomb_friction")
    assert set(found) == {"measurement_delay"}
    assert "wide" in found["measurement_delay"]
    assert list(found["measurement_delay"]) == sorted(found["measurement_delay"], key=BLOCKS.index)
    assert not unseen("joint_3", ("forward_slow", "wide"), "measurement_delay")
    assert not unseen("joint_3", ("forward_slow",), "measurement_delay", noise=1e-5)


def test_play_shows_where_the_torque_changes_its_sign() -> None:
    found = unseen("joint_1", ("forward_slow",), "backlash", noise=0.02)
    assert found.keys() <= {"backlash"}
    assert unseen("joint_2", ("forward_slow",), "backlash") == {"backlash": ()}  # weight keeps the flank


def test_the_full_design_shows_all() -> None:
    robot = max100()
    sweeps = swept("joint_2", POSES, noise=0.001, repeats=1)
    given = equations_of(robot, "joint_2", sweeps)
    names = [name for name in CATALOGUE if applies(given, name) and name != "backlash"]
    assert untestable(given, names, sweeps) == {}


def of_the_paper(name: str, part: float) -> dict[str, UntestableEffect]:
    """Whether sweeps of one direction show an effect where CAD may be off by a part, one sigma."""
    robot = known_to(part)
    sweeps = following(robot, "joint_2", paper_design(robot, "joint_2", POSES, sample_rate=RATE), noise=0.002)
    return untestable(equations_of(robot, "joint_2", sweeps), [name], sweeps)


@pytest.mark.parametrize("name", ["coulomb_friction", "effort_offset"])
def test_one_direction_shows_what_is_constant_as_far_as_gravity_is_known(name: str) -> None:
    """A hundredth of the rated effort is a hundredth of gravity, too: within a wide prior they are the same."""
    assert of_the_paper(name, 0.3)[name].blocks[0] == "backward_slow"
    assert of_the_paper(name, 1e-6) == {}


def test_an_effect_that_the_estimate_takes_unseen_has_weight() -> None:
    """Gravity takes a constant torque of one direction, but no ripple; play that it never lets go moves nothing."""
    assert of_the_paper("coulomb_friction", 0.3)["coulomb_friction"].biases
    assert not of_the_paper("backlash", 0.3)["backlash"].biases
    assert of_the_paper("cogging_torque", 0.3) == {}


JOINT = "joint_2"
THREE = np.array([[0.0, -0.8, 0.3, 0, 0, 0], [0.0, 0.9, 0.9, 0, 0, 0], [0.0, 0.1, -0.4, 0, 0, 0]])


def found(blocks: tuple[str, ...] | None, repeats: int = 1, poses: int = 2) -> AxisDiagnosis:
    """The diagnosis of a machine with nothing but rigid bodies; `blocks`: None for the design of the paper."""
    robot, measured = max100(), THREE[:poses]
    designed = (
        paper_design(robot, JOINT, measured, sample_rate=RATE)
        if blocks is None
        else full_design(robot, JOINT, measured, blocks=blocks, repeats=repeats, sample_rate=RATE, revisit=False)
    )
    sweeps = following(robot, JOINT, designed, noise=0.002)
    return axis_document(diagnose_axis(robot, JOINT, sweeps, twin=False))


@pytest.mark.parametrize(
    ("blocks", "repeats", "words"),
    [(None, 1, "no noise floor"), (("forward_slow",), 2, "would change the estimate unseen")],
)
def test_one_direction_shows_nothing_also_with_repeats(
    blocks: tuple[str, ...] | None, repeats: int, words: str
) -> None:
    axis = found(blocks, repeats)
    assert (axis.verdict, axis.standing) == ("untestable", "open")
    assert (axis.gap.noise_floor_rms is None) == (repeats == 1)
    assert "coulomb_friction" in axis.biasing
    assert set(axis.biasing) <= set(axis.untestable)
    assert words in axis.summary
    assert "is noise" not in axis.summary
    assert axis.next_experiment is not None


def test_a_column_of_time_has_the_products_of_squares() -> None:
    """Warmth differs between repeats; by products between them, drift once explained less than nothing."""
    given = equations_of(max100(), JOINT, swept(JOINT, THREE, blocks=FORWARD, revisit=False, noise=0.0))
    drift = (Term("friction_temperature_drift", (1e4, 1.0)),)
    products = given.system_with(drift).sum(axis=0)[:-1, :-1]
    scale = np.sqrt(np.diag(products))
    assert np.linalg.eigvalsh(products / np.outer(scale, scale)).min() > -1e-9


@pytest.mark.parametrize("seed", range(3))
def test_one_direction_does_not_tell_dry_friction_from_what_bristles_make(seed: int) -> None:
    """Where nothing reverses, the shares of the bristles follow the noise, and their sum is Coulomb friction."""
    sweeps = swept(
        JOINT, THREE, {Term("coulomb_friction"): (60.0,)}, blocks=FORWARD, revisit=False, noise=0.002, seed=seed
    )
    axis = axis_document(diagnose_axis(max100(), JOINT, sweeps, twin=False))
    assert axis.verdict == "ambiguous"
    assert {"coulomb_friction", "presliding_hysteresis"} <= {*axis.candidates}


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
