"""The scorer against diagnoses made by hand, and a few cases through all of it."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.numeric.second_plant.cases import Case, Kind, cases
from tests.numeric.second_plant.faults import FAULTS
from tests.numeric.second_plant.page import digest, page, result
from tests.numeric.second_plant.score import PAGE, RESULTS, run, scores
from tests.numeric.second_plant.scoring import FAULT_WORDS, Outcome, Score, confusion, failed, figures, told

COULOMB = {"coulomb_friction": {"level": 100.0, "bristle": 2e-6}}
COGGING = {"cogging_torque": {"orders": [24.0], "amplitudes": [50.0], "phases": [0.5]}}
PAYLOAD = {"payload": {"mass": 10.0}}
SAID = {"coulomb": {"value": 103.0, "std": 2.0, "unit": "N m"}}


def score(
    hidden: dict[str, Any],
    verdict: str,
    named: tuple[str, ...] = (),
    candidates: tuple[str, ...] = (),
    kind: str = "single",
    size: str = "medium",
    experiment: str | None = None,
    data: tuple[Any, ...] = (),
    fault: str = "",
    part: tuple[Any, ...] = (),
) -> Score:
    companions = ["presliding_hysteresis"] if "coulomb_friction" in hidden else []
    truth = {
        "number": 1, "class": kind, "size": size, "hidden": hidden, "companions": companions, "fault": fault,
    }  # fmt: skip
    said: dict[str, Any] = {
        "verdict": verdict,
        "effects": [{"effect": name, "parameters": SAID if name == "coulomb_friction" else {}} for name in named],
        "candidates": list(candidates),
        "gap": {"before_rms": 50.0, "after_rms": 7.5, "noise_floor_rms": 6.0},
        "next_experiment": {"kind": experiment} if experiment else None,
        "data": list(data),
        "part": list(part),
        "seconds": 2.0,
    }
    return Score(truth, said if verdict != "error" else {"error": "ValueError: no", "seconds": 1.0})


NAME, RIPPLE, BRISTLE = ("coulomb_friction",), ("cogging_torque",), ("presliding_hysteresis",)
GAIN = ("payload", "torque_constant_error")


@pytest.mark.parametrize(
    ("one", "outcome"),
    [
        (score(COULOMB, "named", NAME), Outcome.RIGHT),
        (score(COULOMB, "named", NAME + BRISTLE), Outcome.RIGHT),  # what comes with it is no error
        (score(COULOMB, "named", BRISTLE), Outcome.PART),  # nor is it the name
        (score(COULOMB, "named", RIPPLE), Outcome.WRONG),
        (score(COULOMB, "named", NAME + RIPPLE), Outcome.WRONG),
        (score(COULOMB, "ambiguous", (), NAME + RIPPLE), Outcome.TIE),
        (score(COULOMB, "ambiguous", (), BRISTLE + RIPPLE), Outcome.PART),
        (score(COULOMB, "ambiguous", (), ("backlash", "payload")), Outcome.WRONG),
        (score(COULOMB, "unknown"), Outcome.UNKNOWN),
        (score(COULOMB, "none"), Outcome.MISSED),
        (score(COULOMB, "error"), Outcome.ERROR),
        (score({}, "none", kind="none"), Outcome.RIGHT),
        (score({}, "untestable", kind="none"), Outcome.RIGHT),
        (score({}, "named", NAME, kind="none"), Outcome.WRONG),
        (score({}, "ambiguous", (), NAME + RIPPLE, kind="none"), Outcome.WRONG),
        (score({}, "unknown", kind="none"), Outcome.UNKNOWN),
        (score({"floor_vibration": {}}, "unknown", kind="outside"), Outcome.RIGHT),
        (score({"floor_vibration": {}}, "named", NAME, kind="outside"), Outcome.WRONG),
        (score({"floor_vibration": {}}, "none", kind="outside"), Outcome.MISSED),
        (score({"tilted_base": {}}, "named", ("gravity_error",), kind="outside"), Outcome.RIGHT),  # which it is
        (score({"tilted_base": {}}, "named", ("gravity_error", "payload"), kind="outside"), Outcome.WRONG),
        (score({"floor_vibration": {}}, "named", ("gravity_error",), kind="outside"), Outcome.WRONG),
        (score(COULOMB | COGGING, "named", NAME + RIPPLE, kind="pair"), Outcome.RIGHT),
        (score(COULOMB | COGGING, "named", NAME, kind="pair"), Outcome.PART),
        (score(COULOMB | COGGING, "named", (*NAME, "backlash"), kind="pair"), Outcome.WRONG),
        (score(PAYLOAD, "ambiguous", (), GAIN, experiment="test_mass"), Outcome.RIGHT),
        (score(PAYLOAD, "ambiguous", (), GAIN, experiment="wide"), Outcome.TIE),
        (score(PAYLOAD, "named", ("payload",)), Outcome.RIGHT),
        (score({}, "none", kind="nominal", fault="torque_sign"), Outcome.MISSED),
        (score({}, "untestable", kind="nominal", fault="torque_sign", data=("sign of the torque",)), Outcome.RIGHT),
        (score({}, "named", GAIN[1:], kind="nominal", fault="torque_sign", data=("sign",)), Outcome.WRONG),
    ],
)
def test_what_came_of_a_case(one: Score, outcome: Outcome) -> None:
    assert one.outcome is outcome


def test_a_finding_is_known_by_its_name_before_its_words() -> None:
    assert told("clock_jumps", [{"name": "clock", "sentence": "samples were lost"}])
    assert not told("clock_jumps", [{"name": "units", "sentence": "of all this time"}])
    assert told("torque_spikes", ["3 spikes in sweep 0004"])
    assert not told("torque_spikes", [])
    assert set(FAULT_WORDS) == set(FAULTS)


def test_a_wrong_name_beside_an_unknown_rest_is_counted_apart() -> None:
    one = score(COULOMB, "unknown", part=({"effect": "backlash"}, {"effect": "coulomb_friction"}))
    assert (one.outcome, one.wrong_in_part) == (Outcome.UNKNOWN, {"backlash"})


def test_parameters_are_compared_where_they_are_the_same() -> None:
    assert score(COULOMB, "named", NAME).parameters == {"coulomb_friction: coulomb": pytest.approx(1.5)}
    assert score(COGGING, "named", NAME).parameters == {}
    ripple = score(COGGING, "named", RIPPLE)
    ripple.said["effects"][0]["parameters"] = {"cosine_24": {"value": 50.0 * np.sin(0.5) - 3.0, "std": 1.0}}
    assert ripple.parameters == {"cogging_torque: cosine_24": pytest.approx(-3.0)}


def test_figures_of_a_few() -> None:
    some = [
        score(COULOMB, "named", NAME),
        score(COULOMB, "named", RIPPLE, size="large"),
        score(COULOMB, "unknown"),
        score(COULOMB, "error"),
        score(COULOMB, "named", RIPPLE, size="small"),
        score({}, "none", kind="none"),
        score({}, "unknown", kind="none"),
        score({"floor_vibration": {}}, "unknown", kind="outside"),
        score(COULOMB | COGGING, "named", NAME + RIPPLE, kind="pair"),
        score(COULOMB | COGGING | PAYLOAD, "named", ("backlash",), kind="triple"),
        score({}, "none", kind="nominal", fault="torque_sign"),
    ]
    found = figures(some)
    assert (found["big_cases"], found["small_cases"], found["none_cases"], found["errors"]) == (4, 1, 2, 1)
    assert (found["right_name"], found["wrong_name"], found["called_unknown"]) == (25, 25, 25)
    assert (found["small_wrong"], found["false_alarms"], found["outside_unknown"]) == (100, 50, 100)
    assert (found["pairs_exact"], found["triples_wrong"], found["faults_told"]) == (100, 100, 0)
    assert (found["gap_median"], found["parameters"], found["parameters_within_two_std"]) == (1.25, 2, 100)
    assert confusion(some)["coulomb_friction"] == {
        "coulomb_friction": 1, "cogging_torque": 2, "unknown": 1, "error": 1,
    }  # fmt: skip
    assert len(failed(some)) == 7
    text = page(result(some, some, "python -m something", "2030-01-02", "0123abc"))
    assert "| right name, medium and large singles, % | 25 | >= 95 |" in text
    assert "Date 2030-01-02, commit 0123abc." in text


def test_the_page_is_of_todays_code() -> None:
    """Score again (`--write`) when this fails: the figures are of a diagnosis that computed otherwise."""
    told = json.loads(RESULTS.read_text())
    assert told["code"] == digest()
    assert PAGE.read_text() == page(told)


SAMPLE = (
    *(
        Case(77, n, Kind.SINGLE, (name,), ("medium", "large")[n % 2])
        for n, name in enumerate(("coulomb_friction", "hose_spring", "measurement_delay", "payload"), 1)
    ),
    *cases(77, none=3, pairs=1, triples=1, outside=1, nominal=2),
)


@pytest.mark.parametrize("one", SAMPLE, ids=lambda one: f"{one.number:05}-{'-'.join(one.names) or 'none'}")
def test_a_fair_sample_goes_through(one: Case, tmp_path: Path) -> None:
    """Some of every class, small designs: each is diagnosed, scored against a truth that it never saw, none wrongly."""
    run(one, tmp_path, small=True)
    (found,) = scores([one], tmp_path)
    assert found.outcome not in (Outcome.ERROR, Outcome.WRONG), found.said
    assert "hidden" not in found.said
    assert figures([found])["seconds_longest"] == found.said["seconds"] > 0


@pytest.mark.parametrize("number", [50001, 50008, 50042])
def test_a_pair_is_named(number: int, tmp_path: Path) -> None:
    """Friction of another law imitates both but for 3 % and 0.5 %; two ripples leave 0.015 %, more than noise."""
    (one,) = (one for one in cases(8511, pairs=43) if one.number == number)
    run(one, tmp_path)
    assert scores([one], tmp_path)[0].outcome is Outcome.RIGHT
