"""The scorer against diagnoses made by hand, and the sealed cases: what they hold and what they keep back."""

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from tests.numeric.blind.cases import Case, Design, Evidence, Kind, cases, scene
from tests.numeric.blind.effects import CATALOGUE, OUTSIDE, PAIRS
from tests.numeric.blind.page import page, result
from tests.numeric.blind.scoring import Outcome, Score, confusion, figures, kinds, outcomes


def score(
    hidden: tuple[str, ...],
    verdict: str,
    named: tuple[str, ...] = (),
    candidates: tuple[str, ...] = (),
    kind: str = "single",
    experiment: str | None = None,
) -> Score:
    parameters = {"coulomb": {"value": 103.0, "std": 2.0, "unit": "N m"}}
    diagnosis: dict[str, Any] = {
        "verdict": verdict,
        "effects": [{"effect": name, "parameters": parameters} for name in named],
        "candidates": list(candidates),
        "gap": {"before_rms": 50.0, "after_rms": 7.5, "noise_floor_rms": 6.0},
        "next_experiment": {"kind": experiment, "seconds": 60.0} if experiment else None,
        "untestable": ["backlash"],
        "seconds": 2.0,
    }
    truth = {"number": 1, "kind": kind, "names": list(hidden), "parameters": {n: {"coulomb": 100.0} for n in hidden}}
    return Score(truth, [diagnosis])


COULOMB, COGGING = ("coulomb_friction",), ("cogging_torque",)
BOTH = COULOMB + COGGING


@pytest.mark.parametrize(
    ("one", "outcome"),
    [
        (score(COULOMB, "named", COULOMB), Outcome.RIGHT),
        (score(COULOMB, "named", COGGING), Outcome.WRONG),
        (score(COULOMB, "named", BOTH), Outcome.MORE),
        (score(COULOMB, "ambiguous", (), BOTH), Outcome.TIE),
        (score(COULOMB, "ambiguous", (), ("backlash", "payload")), Outcome.WRONG),
        (score(COULOMB, "unknown"), Outcome.UNKNOWN),
        (score(COULOMB, "none"), Outcome.MISSED),
        (score(COULOMB, "untestable"), Outcome.MISSED),
        (score((), "none", kind="none"), Outcome.RIGHT),
        (score((), "named", COULOMB, kind="none"), Outcome.WRONG),
        (score((), "ambiguous", (), BOTH, kind="none"), Outcome.WRONG),
        (score(("second_mass",), "unknown", kind="outside"), Outcome.RIGHT),
        (score(("second_mass",), "named", COULOMB, kind="outside"), Outcome.WRONG),
        (score(BOTH, "named", BOTH, kind="pair"), Outcome.RIGHT),
        (score(BOTH, "named", COULOMB, kind="pair"), Outcome.PART),
        (score(BOTH, "named", (*COULOMB, "backlash"), kind="pair"), Outcome.WRONG),
    ],
)
def test_what_came_of_a_case(one: Score, outcome: Outcome) -> None:
    assert one.outcome is outcome


def test_what_only_a_mass_tells_apart_is_right_as_a_tie_with_that_mass() -> None:
    tie = ("payload", "torque_constant_error")
    assert score(("payload",), "ambiguous", (), tie, experiment="test mass").expected
    assert not score(("payload",), "ambiguous", (), tie, experiment="wide").expected
    assert not score(("payload",), "named", ("payload",)).expected


def test_the_last_experiment_decides_what_came_of_it() -> None:
    first, last = score(COULOMB, "ambiguous", (), BOTH, experiment="wide"), score(COULOMB, "named", COULOMB)
    both = Score(first.truth, [first.diagnosis, last.diagnosis])
    assert (both.outcome, both.last.outcome) == (Outcome.TIE, Outcome.RIGHT)
    assert figures([both])["right_after_experiments"] == 100


def test_what_cannot_be_seen_is_not_excluded_where_more_is_asked_for() -> None:
    assert score(("backlash",), "none", experiment="reversal").not_excluded
    assert not score(("backlash",), "none").not_excluded
    assert not score(COULOMB, "none", experiment="reversal").not_excluded
    assert not score(("backlash",), "none", experiment="reversal").in_tie_set


def test_machine_time_is_that_of_the_experiments_run() -> None:
    first, last = score(COULOMB, "ambiguous", (), BOTH, experiment="wide"), score(COULOMB, "ambiguous", (), BOTH)
    asked = Score(first.truth, [first.diagnosis, first.diagnosis, last.diagnosis])
    found = figures([asked, score(COULOMB, "named", COULOMB)])
    assert (found["experiments"], found["machine_seconds_median"], found["machine_seconds_longest"]) == (2, 120, 120)
    assert kinds([asked]) == {"wide": {"count": 2, "median": 60.0, "sum": 120.0}}


def test_figures_of_a_few() -> None:
    some = [
        score(COULOMB, "named", COULOMB),
        score(COULOMB, "named", COGGING),
        score(COULOMB, "ambiguous", (), BOTH),
        score(COULOMB, "unknown"),
        score((), "none", kind="none"),
        score((), "unknown", kind="none"),
        score(("second_mass",), "unknown", kind="outside"),
        score(BOTH, "named", BOTH, kind="pair"),
    ]
    found = figures(some)
    assert (found["single_cases"], found["none_cases"], found["false_alarms"]) == (4, 2, 1)
    assert (found["right_name"], found["in_tie_set"], found["wrong_name"], found["called_unknown"]) == (25, 50, 25, 25)
    assert (found["outside_unknown"], found["pairs_exact"], found["gap_over_noise_floor"]) == (100, 100, 1.25)
    assert (found["parameters"], found["parameters_within_two_std"]) == (2 + 1, 100)  # 1.5 std off
    assert outcomes(some)["coulomb_friction"] == {"right": 1, "wrong": 1, "tie": 1, "unknown": 1}
    assert confusion(some)["coulomb_friction"] == {
        "coulomb_friction": 1, "cogging_torque": 1, "ambiguous": 1, "unknown": 1
    }  # fmt: skip
    told = result(some, "python -m something")
    text = page({"full": told, "paper": told})
    assert "| right name | 25 | >= 95 % |" in text
    assert "| right name | 25 |  |" in text
    assert "| second_mass |" in text
    assert "| coulomb_friction: coulomb | 2 | 2 | 2 |" in text


def test_every_effect_of_the_catalogue_is_hidden_in_every_size() -> None:
    some = list(cases(3, singles=2, none=4, pairs=20, outside=8, sizes=("small", "large")))
    singles = [case for case in some if case.kind is Kind.SINGLE]
    assert {(case.names[0], case.size) for case in singles} == {(n, s) for n in CATALOGUE for s in ("small", "large")}
    assert len(singles) == 2 * 2 * len(CATALOGUE)
    assert [case.number for case in some] == list(range(len(some)))
    assert {case.names for case in some if case.kind is Kind.PAIR} == set(PAIRS)
    assert {case.names[0] for case in some if case.kind is Kind.OUTSIDE} == set(OUTSIDE)


def test_evidence_holds_no_truth() -> None:
    """What a diagnosis gets: robot as on paper, joint, sweeps. A hidden machine's record is what it was made of."""
    one = scene(Case(7, Kind.SINGLE, ("effort_offset",), "large", Design.PAPER, (11, 7)))
    evidence = one.evidence()
    assert {field.name for field in fields(Evidence)} == {"robot", "joint", "designs", "sweeps", "measure"}
    assert one.robot.name == "blind-0007"
    assert len(evidence.sweeps) == 4
    assert all(sweep.recording.load_position is None for sweep in evidence.sweeps)
    again = scene(Case(7, Kind.SINGLE, ("effort_offset",), "large", Design.PAPER, (11, 7))).evidence()
    np.testing.assert_array_equal(again.sweeps[0].recording.effort, evidence.sweeps[0].recording.effort)


def test_a_gear_stays_as_warm_as_earlier_sweeps_have_left_it() -> None:
    one = scene(Case(1, Kind.SINGLE, ("friction_temperature_drift",), "large", Design.PAPER, (3, 1)))
    later = [
        replace(design, spec=design.spec.model_copy(update={"started_at": design.spec.started_at + 120.0}))
        for design in one.designs
    ]
    first, again = one.machine.measure(one.designs), one.machine.measure(later)
    friction = [abs(float(np.mean(part[0].recording.effort))) for part in (first, again)]
    fresh = scene(Case(1, Kind.SINGLE, ("friction_temperature_drift",), "large", Design.PAPER, (3, 1)))
    cold = abs(float(np.mean(fresh.machine.measure(later)[0].recording.effort)))
    assert len(again) == len(later)
    assert abs(friction[1] - friction[0]) > 5 * abs(cold - friction[0])


@pytest.mark.parametrize("name", sorted(CATALOGUE | OUTSIDE))
def test_a_hidden_effect_is_about_as_large_as_it_says(name: str) -> None:
    """The record differs from that of the same machine with nothing hidden by the effect's size, or a few times it."""
    case = Case(1, Kind.SINGLE, (name,), "large", Design.FULL, (3, 1))
    hidden, bare = scene(case), scene(case, bare=True)
    blocks = ("forward_slow", "reversal", "wide", "revisit_forward_slow")
    some = [design for design in hidden.designs if design.spec.block in blocks and design.spec.repeat == 0]
    pairs = zip(hidden.machine.measure(some), bare.machine.measure(some), strict=True)
    difference = max(float(np.abs(one.recording.effort - other.recording.effort).max()) for one, other in pairs)
    torque = hidden.truth.torque
    assert 0.3 * torque < difference - 4 * hidden.truth.noise < 8 * torque
