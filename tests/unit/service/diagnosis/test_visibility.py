"""What designs made by hand can show, and which of the missing blocks would."""

import numpy as np
import pytest

from service.diagnosis.design import BLOCKS, full_design, paper_design
from service.diagnosis.effects import CATALOGUE
from service.diagnosis.visibility import untestable
from tests.numeric.campaign import max100
from tests.unit.service.diagnosis.following import RATE, equations_of, following

POSES = np.array([[0.0, -0.8, 0.3, 0, 0, 0], [0.0, 0.9, 0.9, 0, 0, 0]])


def unseen(joint: str, blocks: tuple[str, ...], *names: str, noise: float = 0.005) -> dict[str, tuple[str, ...]]:
    robot = max100()
    designed = full_design(robot, joint, POSES, blocks=blocks, sample_rate=RATE, revisit=False)
    sweeps = following(robot, joint, designed, noise=noise)
    return untestable(equations_of(robot, joint, sweeps), names, sweeps)


def test_slow_sweeps_cannot_show_what_needs_high_frequencies() -> None:
    found = unseen("joint_3", ("forward_slow",), "measurement_delay", "coulomb_friction")
    assert set(found) == {"measurement_delay"}
    assert "wide" in found["measurement_delay"]
    assert not unseen("joint_3", ("forward_slow", "wide"), "measurement_delay")


def test_what_shows_depends_on_the_noise() -> None:
    assert not unseen("joint_3", ("forward_slow",), "measurement_delay", noise=1e-5)


def test_play_shows_where_the_torque_changes_its_sign() -> None:
    found = unseen("joint_1", ("forward_slow",), "backlash", noise=0.02)
    assert found.keys() <= {"backlash"}
    assert unseen("joint_2", ("forward_slow",), "backlash") == {"backlash": ()}  # weight keeps the flank


def test_the_full_design_shows_all() -> None:
    robot = max100()
    designed = full_design(robot, "joint_2", POSES, repeats=1, sample_rate=RATE)
    sweeps = following(robot, "joint_2", designed, noise=0.001)
    given = equations_of(robot, "joint_2", sweeps)
    names = [name for name, effect in CATALOGUE.items() if effect.applies(given.tracks) and name != "backlash"]
    assert untestable(given, names, sweeps) == {}


@pytest.mark.parametrize(
    "name", ["coulomb_friction", "gravity_error", "hose_spring", "cogging_torque", "effort_offset"]
)
def test_the_papers_sweeps_show_what_is_large_at_rest(name: str) -> None:
    robot = max100()
    sweeps = following(robot, "joint_2", paper_design(robot, "joint_2", POSES, sample_rate=RATE), noise=0.002)
    found = untestable(equations_of(robot, "joint_2", sweeps), [name], sweeps)
    assert found == {}


def test_blocks_are_told_in_their_order() -> None:
    found = unseen("joint_3", ("forward_slow",), "measurement_delay")["measurement_delay"]
    assert list(found) == sorted(found, key=BLOCKS.index)
