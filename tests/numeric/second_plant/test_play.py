"""Play of a gear on machines of the second plant that nothing was tuned on: named with its value; others are not."""

from functools import partial

import numpy as np
import pytest

from service.diagnosis.diagnose import diagnose_axis
from service.diagnosis.document import axis_document
from service.diagnosis.play import measured_play
from service.model.configuration import Cell
from service.planning.diagnosis import ExperimentPlace
from service.planning.documents import ExperimentRequest
from tests.numeric.second_plant.cases import Case, Kind, make
from tests.numeric.second_plant.draft import Draft, steady
from tests.numeric.second_plant.dry import bristle

SEED = 9301


def sticking(share: float, draft: Draft) -> None:
    """Dry friction of the load, a share of the rated effort: it stops between the flanks."""
    draft.train.dry_on_load.append(bristle(draft, steady(draft.even(share * draft.rated)), 2e-6))


@pytest.mark.parametrize(("size", "share"), [("medium", 0.0), ("large", 0.0), ("medium", 0.02)])
def test_backlash_is_named_with_its_width(size: str, share: float) -> None:
    one = Case(SEED, round(1000 * share), Kind.SINGLE, ("backlash",), size)
    robot, joint, sweeps, truth = make(one, small=True, change=partial(sticking, share))
    found = axis_document(diagnose_axis(robot, joint, sweeps))
    assert (found.verdict, [effect.effect for effect in found.effects]) == ("named", ["backlash"])
    play = found.effects[0].parameters["play"]
    assert play.std is not None
    assert play.std < play.value / 4
    assert abs(play.value - truth.hidden["backlash"]["play"]) < 3 * play.std
    assert found.gap.after_rms < found.gap.before_rms / 2


@pytest.mark.parametrize(
    ("name", "size"),
    [("presliding_hysteresis", "medium"), ("presliding_hysteresis", "large"), ("joint_elasticity", "medium"),
     ("joint_elasticity", "large"), ("stribeck_friction", "large"), ("transmission_error", "large"), ("", "none")],
)  # fmt: skip
def test_no_other_machine_has_play(name: str, size: str) -> None:
    one = Case(SEED, 1, Kind.SINGLE, (name,), size) if name else Case(SEED, 1, Kind.NONE, (), size)
    robot, joint, sweeps, _ = make(one, small=True)
    assert measured_play(robot, joint, sweeps) is None


def test_an_encoder_of_the_load_measures_the_play_itself() -> None:
    one = Case(SEED, 2, Kind.SINGLE, ("backlash",), "medium")
    robot, joint, sweeps, truth = make(one, small=True, load_encoder=True)
    play = measured_play(robot, joint, sweeps)
    assert play is not None
    assert play.width == pytest.approx(truth.hidden["backlash"]["play"], rel=0.03)
    assert play.std < 0.03 * play.width


@pytest.mark.parametrize(("seed", "size"), [(SEED, "medium"), (8603, "medium"), (8611, "medium"), (8603, "large")])
def test_one_direction_does_not_show_it_and_asks_for_the_reversal(seed: int, size: str) -> None:
    """Play turns the lines like a delay of 17 to 28 ms, but it distorts: no fault of the record."""
    one = Case(seed, 4 if seed == SEED else 1 + (size == "large"), Kind.SINGLE, ("backlash",), size)
    robot, joint, sweeps, _ = make(one, small=True)
    forward = [sweep for sweep in sweeps if sweep.spec.block == "forward_slow"]
    place = ExperimentPlace(ExperimentRequest(robot_id=1), Cell(name="free"), ())
    found = diagnose_axis(robot, joint, forward, runnable=partial(place.runnable, robot))
    assert found.data == ()
    assert found.verdict.value in ("unknown", "ambiguous", "untestable")
    assert found.next_experiment is not None
    about_standstill = [s.spec for s in found.next_experiment.sweeps if not s.spec.offset_velocity]
    assert {spec.repeat for spec in about_standstill} == {0, 1}
    assert np.ptp([spec.sines[0].amplitude for spec in about_standstill]) < 1e-3
