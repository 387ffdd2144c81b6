"""Laws proposed for gaps of the second plant that no effect of the catalogue explains."""

import numpy as np
import pytest

from service.diagnosis.diagnose import diagnose_axis
from service.diagnosis.document import as_document
from service.diagnosis.fit.equations import Equations, equations, grouped
from service.diagnosis.law import Law, proposed_law
from service.diagnosis.rows.signals import tracks
from tests.numeric.second_plant.cases import Case, Kind, make
from tests.numeric.second_plant.draft import Draft
from tests.numeric.second_plant.laws import Law as Torque

SEED = 9641


def given(one: Case, change: float = 0.0) -> Equations:
    """The equations of a case; `change`: torque of a push along the motion that dies away, of the rated effort."""

    def pushed(draft: Draft) -> None:
        size = change * draft.rated
        draft.train.on_motor.append(Torque(lambda now: -size * np.exp(-now.time) * np.tanh(now.velocity / 1e-3)))

    robot, joint, sweeps, _ = make(one, small=True, change=pushed if change else None)
    motion = tracks(robot, joint, sweeps)
    return equations(motion, grouped(motion))


def test_friction_that_dies_away_is_proposed_and_enters_no_model() -> None:
    robot, joint, sweeps, truth = make(Case(SEED, 1, Kind.OUTSIDE, ("dry_seal",), "medium"), small=True)
    found = diagnose_axis(robot, joint, sweeps)
    assert found.verdict.value == "unknown"
    document = as_document(robot, [found])
    axis = document.axes[joint]
    assert axis.law is not None
    assert axis.law.formula == "c exp(-t / t0) sign(v)"
    assert axis.law.closed > 0.5
    assert axis.law.after_rms < axis.law.before_rms / 2
    pace = axis.law.parameters["t0"].value  # of a decay that begins 0.7 s after the start
    assert 0.7 < pace / truth.hidden["dry_seal"]["time_constant"] < 1.5
    assert axis.standing == "unexplained"
    assert not axis.effects
    assert not document.model.effects.get(joint)
    assert axis.next_experiment is not None
    assert axis.next_experiment.reason == "It tests the proposed law."


@pytest.mark.parametrize("number", [1, 2, 3])
def test_no_law_is_found_in_noise(number: int) -> None:
    assert proposed_law(given(Case(SEED, number, Kind.NONE, (), "none")), ()) is None


def test_friction_that_drives_the_axis_is_no_law() -> None:
    braking, driving = (proposed_law(given(Case(SEED, 1, Kind.NONE, (), "none"), size), ()) for size in (-0.02, 0.02))
    assert braking is not None
    assert braking.kinds == ("dies",)
    assert driving is None


def test_two_poses_are_too_few() -> None:
    robot, joint, sweeps, _ = make(Case(SEED, 1, Kind.OUTSIDE, ("dry_seal",), "medium"), small=True)
    motion = tracks(robot, joint, [sweep for sweep in sweeps if sweep.spec.pose != sweeps[0].spec.pose])
    assert proposed_law(equations(motion, grouped(motion)), ()) is None


def test_a_law_is_told_with_its_place_and_gain() -> None:
    law = Law(("lever", "dry"), {}, 2.0, 0.5, 12, -0.3, 1.25)
    assert law.formula == "c sin(q - q0) / sqrt(1 - k cos(q - q0)) + c sign(v)"
    assert law.of_position
    assert "75 % of the gap, from 2 N m to 0.5 N m. It is largest at -0.30 rad, with 1.25 N m" in law.sentence(
        "a", "N m"
    )
