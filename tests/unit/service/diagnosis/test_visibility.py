"""What designs made by hand can show, and which of the missing blocks would."""

import numpy as np
import pytest

from service.diagnosis.effects import CATALOGUE
from service.diagnosis.fit.equations import applies
from service.diagnosis.sensitivity.visibility import Hidden, untestable
from service.identification.design.diagnosis_sweeps import BLOCKS, paper_design
from tests.numeric.campaign import max100
from tests.unit.service.diagnosis.following import RATE, equations_of, following, known_to, swept

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
    assert not unseen("joint_3", ("forward_slow", "wide"), "measurement_delay")


def test_what_shows_depends_on_the_noise() -> None:
    assert not unseen("joint_3", ("forward_slow",), "measurement_delay", noise=1e-5)


@pytest.mark.slow
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


def of_the_paper(name: str, part: float) -> dict[str, Hidden]:
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
    """Gravity takes a constant torque of one direction. Play that gravity never lets go moves nothing."""
    assert of_the_paper("coulomb_friction", 0.3)["coulomb_friction"].biases
    assert not of_the_paper("backlash", 0.3)["backlash"].biases


def test_one_direction_shows_ripples_whatever_gravity_is() -> None:
    assert of_the_paper("cogging_torque", 0.3) == {}


def test_blocks_are_told_in_their_order() -> None:
    found = unseen("joint_3", ("forward_slow",), "measurement_delay")["measurement_delay"]
    assert list(found) == sorted(found, key=BLOCKS.index)
