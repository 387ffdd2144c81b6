"""Each search of a diagnosis says how it ended; a number that is not finite is refused with axis and sweep."""

import io
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rich.console import Console

from service import BadInput
from service.cli.terminal import print_result
from service.diagnosis import axis_document, diagnose_axis, model_document
from service.diagnosis.effects import CATALOGUE
from service.diagnosis.effects.effect import Inexpressible
from service.diagnosis.fit import equations as equations_module
from service.diagnosis.fit.calibration import Weighed, WeighedGain, weighed_gain
from service.diagnosis.fit.cross_products import Ended, NotFinite, covariance, given_rest, solve
from service.diagnosis.fit.equations import Equations, Term
from service.diagnosis.fit.search import CurrentModel, together
from service.diagnosis.fit.select import Selection, settled
from service.diagnosis.model.scenario import inertia_factors
from service.diagnosis.rows.rigid import nominal_load
from service.diagnosis.unfinished import unfinished
from service.identification.design.diagnosis_sweeps import full_design
from service.model import Sweep
from service.report.diagnosis import diagnosis_page
from tests.numeric.campaign import max100
from tests.stored.documents import axis_document as stored_axis, diagnosis
from tests.unit.service.diagnosis.following import equations_of, known_to, swept
from tests.unit.service.diagnosis.test_calibration import MASS, POSES as MASS_POSES, SLOW, TIGHT, measured
from tests.unit.service.diagnosis.test_twin import axis_of

JOINT = "joint_2"
POSES = np.array([[0.0, -0.8, 0.3, 0, 0, 0], [0.0, 0.9, 0.9, 0, 0, 0]])
STRIBECK = Term("stribeck_friction", (0.01, 1.0))
SPRING = Term("joint_elasticity", (2e-6, 1e-3, 0.5, 0.0, 40.0))


def sweeps_of(hidden: Term | None = None, *coefficients: float, blocks: Sequence[str] = SLOW) -> list[Sweep]:
    return swept(JOINT, POSES, {hidden: coefficients} if hidden else None, blocks=blocks)


@cache
def stribeck() -> Equations:
    """An axis with Stribeck friction."""
    blocks = ("forward_slow", "backward_slow", "forward_fast")
    return equations_of(max100(), JOINT, sweeps_of(STRIBECK, 60.0, 60.0, blocks=blocks))


@cache
def soft() -> Equations:
    """An axis with a soft gear."""
    robot = max100()
    sheet = robot.axis(JOINT).reflected_motor_inertia or 0.0
    term = replace(SPRING, shape=(*SPRING.shape[:4], sheet))
    return equations_of(robot, JOINT, sweeps_of(term, 1.0, blocks=("forward_slow", "wide")))


def spoiled(sweeps: Sequence[Sweep], number: int, channel: str, value: float) -> list[Sweep]:
    """The sweeps with one sample of one channel replaced."""
    changed = getattr(sweeps[number].recording, channel).copy()
    changed[40] = value
    recording = replace(sweeps[number].recording, **{channel: changed})
    return [replace(one, recording=recording) if k == number else one for k, one in enumerate(sweeps)]


# -- numbers that are not finite


@pytest.mark.parametrize("channel", ["time", "effort", "velocity", "position"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_sample_that_is_no_number_is_refused_with_axis_and_sweep(channel: str, value: float) -> None:
    sweeps = sweeps_of()
    place = f"^sweep {sweeps[2].spec.id} of {JOINT}: 1 of [0-9]+ values of {channel} are not finite, .* number 40$"
    with pytest.raises(BadInput, match=place):
        diagnose_axis(max100(), JOINT, spoiled(sweeps, 2, channel, value), twin=False)


def test_so_are_one_with_the_test_mass_and_efforts_whose_squares_overflow() -> None:
    sweeps = sweeps_of()
    weighed = Weighed(MASS, tuple(spoiled(sweeps, 1, "effort", np.nan)))
    with pytest.raises(BadInput, match=f"^sweep {sweeps[1].spec.id} of {JOINT}: 1 of .* values of effort"):
        diagnose_axis(max100(), JOINT, sweeps, weighed=weighed, twin=False)
    huge = [replace(one, recording=replace(one.recording, effort=1e160 * one.recording.effort)) for one in sweeps]
    place = f"^sweep .* of {JOINT}: .* the squares of its effort"
    with np.errstate(all="ignore"), pytest.raises(BadInput, match=place):
        diagnose_axis(max100(), JOINT, huge, twin=False)


def test_a_column_of_an_effect_that_is_no_number_is_refused_with_its_sweep(monkeypatch: pytest.MonkeyPatch) -> None:
    """As an effect of another package may have it."""
    given = stribeck()

    def columns(*_: object) -> list[NDArray[np.float64]]:
        column = np.ones_like(given.tracks.velocity)
        column[3, 7] = np.nan
        return [column]

    broken = replace(CATALOGUE["coulomb_friction"], columns=columns)
    monkeypatch.setattr(equations_module, "CATALOGUE", {"coulomb_friction": broken})
    place = f"^sweep {given.tracks.specs[3].id} of {JOINT}: 1 of .* values of a column of coulomb_friction"
    for look in (given.rows, given.gathered):
        with pytest.raises(BadInput, match=place):
            look(Term("coulomb_friction"))


def test_columns_whose_squares_overflow_are_refused_with_the_axis(monkeypatch: pytest.MonkeyPatch) -> None:
    shipped = CATALOGUE["coulomb_friction"]
    huge = replace(shipped, columns=lambda motion, model, shape: [1e200 * motion.direction])
    monkeypatch.setattr(equations_module, "CATALOGUE", {**CATALOGUE, "coulomb_friction": huge})
    with np.errstate(all="ignore"), pytest.raises(BadInput, match=f"^{JOINT}: the equations have entries that are not"):
        diagnose_axis(max100(), JOINT, sweeps_of(), known={"coulomb_friction": {}}, twin=False)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("place", [(0, 0), (0, 1), (2, 2)])
def test_a_system_that_is_not_finite_has_no_solution(value: float, place: tuple[int, int]) -> None:
    system, precision = np.array([[2.0, 0.1, 1.0], [0.1, 3.0, 0.5], [1.0, 0.5, 9.0]]), np.zeros((1, 1))
    assert np.isfinite(solve(system, precision)[1])
    system[place] = system[place[::-1]] = value
    for of in (solve, covariance):
        with pytest.raises(NotFinite, match="not finite"):
            of(system, precision)
    with pytest.raises(NotFinite, match="not finite"):
        given_rest(system, precision, np.ones(1))


# -- searches that use up their steps


def test_the_search_of_a_shape_says_how_it_ended() -> None:
    current = CurrentModel(stribeck(), ())
    start = current.explanation(Term("stribeck_friction", (0.004, 1.0)))
    assert start.terms[-1].ended is None
    assert current.refined(start, steps=1).terms[-1].ended is Ended.UNFINISHED
    found = current.refined(start, steps=50)
    assert found.terms[-1].ended in (Ended.SETTLED, Ended.AT_REST)
    assert found.terms[-1].shape[0] == pytest.approx(STRIBECK.shape[0], rel=0.1)
    assert found.terms[-1] == replace(found.terms[-1], ended=None)  # how a search ended is no part of the model


@pytest.mark.slow
def test_the_steps_of_load_and_spring_together_say_how_they_ended() -> None:
    given = soft()
    start = CurrentModel(given, ()).best("joint_elasticity")
    assert together(given, start, steps=1)[1].terms[-1].ended is Ended.UNFINISHED
    assert together(given, start, steps=60)[1].terms[-1].ended in (Ended.SETTLED, Ended.AT_REST)


@cache
def chosen() -> Selection:
    """A soft gear, not yet refined, in a load that is not yet fitted."""
    given = soft()
    current = CurrentModel(given, ())
    return Selection(given, current.best("joint_elasticity"), current.alone(), ())


def test_the_fit_of_load_and_shapes_says_how_it_ended() -> None:
    assert settled(chosen(), (), steps=1).ended is Ended.UNFINISHED
    assert settled(chosen(), (), steps=60).ended is Ended.SETTLED


def offset(sweeps: Sequence[Sweep], seed: int) -> list[Sweep]:
    """The sweeps with another offset of the effort in each, N m."""
    random = np.random.default_rng(seed)
    for one in sweeps:
        one.recording.effort[:] += random.normal(0, 10.0)
    return list(sweeps)


def test_the_noise_of_a_gain_says_whether_it_has_settled() -> None:
    robot = known_to(TIGHT)
    designed = full_design(robot, JOINT, MASS_POSES, repeats=1, blocks=SLOW, revisit=False)
    bare = offset(measured(robot, JOINT, designed, gain=1.0, mass=None, by_load=0.05), 1)
    weighed = Weighed(MASS, tuple(offset(measured(robot, JOINT, designed, gain=1.0, mass=MASS, by_load=0.05), 2)))
    once, twice = (weighed_gain(robot, JOINT, bare, weighed, rounds=rounds) for rounds in (1, 2))
    assert once.noise_change > 0.05 > twice.noise_change
    assert weighed_gain(robot, JOINT, bare, weighed) == twice


# -- what a user sees of it


def test_a_search_that_used_up_its_steps_is_a_warning_of_the_axis() -> None:
    start = chosen()
    alone = replace(start, chosen=start.chosen.searched(0, Ended.UNFINISHED), ended=Ended.UNFINISHED)
    of_shape, of_load, of_gain = unfinished(JOINT, alone, WeighedGain(1.0, 0.01, 0.2))
    effects = (of_shape.effect, of_load.effect, of_gain.effect)
    assert effects == ("joint_elasticity", None, "torque_constant_error")
    assert of_shape.sentence.startswith(f"{JOINT}: the search of the shape of joint elasticity used up its")
    assert "load" in of_load.sentence
    assert "still changes by 20 % in the last round; limit 5 %" in of_gain.sentence
    assert unfinished(JOINT, start, WeighedGain(1.0, 0.01, 0.01)) == ()


@pytest.mark.slow
def test_the_document_has_it_only_where_there_is_one() -> None:
    found = diagnose_axis(max100(), JOINT, sweeps_of(Term("coulomb_friction"), 60.0), twin=False)
    assert found.unfinished == ()
    assert "unfinished" not in axis_document(found).as_json()
    some = unfinished(JOINT, replace(chosen(), ended=Ended.UNFINISHED), None)
    assert axis_document(replace(found, unfinished=some)).unfinished == some


def test_command_and_report_show_it_and_older_documents_are_read() -> None:
    told = {"effect": None, "sentence": "joint_1: the search <1> used up its steps.", "action": "Compare the gap."}
    document = diagnosis(joint_1=stored_axis(unfinished=[told]))
    assert "<b>warning:</b> joint_1: the search &lt;1&gt; used up its steps. Compare the gap." in (
        diagnosis_page(document, "t").html()
    )
    shown = io.StringIO()
    print_result(document, Console(file=shown, width=200))
    assert "Warning: joint_1: the search <1> used up its steps. Compare the gap." in shown.getvalue()
    older = diagnosis(joint_1=stored_axis())
    assert older.axes["joint_1"].unfinished == ()
    assert "unfinished" not in older.axes["joint_1"].as_json()
    assert "<b>warning:</b>" not in diagnosis_page(older, "t").html()


# -- links of a scenario


def test_inertias_of_links_that_are_not_found_are_refused() -> None:
    robot = max100()
    inertia = 3.0 * nominal_load(robot, JOINT, POSES)[0]
    wanted = [(robot.index(JOINT), POSES, inertia)]
    factors = inertia_factors(robot, {}, wanted)
    assert max(factors.values()) == pytest.approx(10.0, rel=0.01)  # the limit
    with pytest.raises(Inexpressible, match="their fit did not converge: The maximum number of iterations"):
        inertia_factors(robot, {}, wanted, steps=1)
    with pytest.raises(Inexpressible, match="those of the axes are not finite"):
        inertia_factors(robot, {}, [(robot.index(JOINT), POSES, np.array([np.nan, 100.0]))])


@pytest.mark.slow
def test_a_model_without_possible_masses_has_those_of_cad_with_a_note() -> None:
    """Gravity that only a link of negative mass explains; before, there was no document at all."""
    axis = axis_of(JOINT, "coulomb_friction")
    for pose in axis["fit"]["gravity"]:
        pose["torque"], pose["slope"] = -30 * pose["torque"], -30 * pose["slope"]
    found = model_document(max100(), diagnosis(**{JOINT: axis}))
    (note,) = [note for note in found.notes if "mass of" in note]
    assert note.endswith("masses and centres of the links are those of CAD here")
    scenario: Any = found.scenario
    assert not any({"mass", "shift"} & set(link) for link in scenario["links"].values())
    assert set(scenario["axes"]) == {JOINT}
