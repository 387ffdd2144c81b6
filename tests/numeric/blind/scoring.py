"""Truth against diagnosis: what came of a case, and the figures and tables of many."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np

from tests.numeric.blind.cases import Kind
from tests.numeric.blind.effects import BY_TEST_MASS, CATALOGUE, OUTSIDE

Document = dict[str, Any]


class Outcome(Enum):
    """What a diagnosis made of a case."""

    RIGHT = "right"  # every hidden effect named and no other; of none: none; of one outside: unknown
    TIE = "tie"  # ambiguous, the truth among the candidates
    PART = "part"  # some of the hidden effects named, no other
    MORE = "more"  # the hidden effects named, and others
    WRONG = "wrong"  # something named, or left as the only candidates, that is not there
    UNKNOWN = "unknown"
    MISSED = "missed"  # nothing found


@dataclass(frozen=True)
class Score:
    """One case: truth and diagnosis as documents, and what came of it; `diagnosis` is that before any experiment."""

    truth: Document
    diagnoses: list[Document]  # after no, one, ... experiments

    @property
    def diagnosis(self) -> Document:
        return self.diagnoses[0]

    @property
    def last(self) -> "Score":
        """The case as the last experiment left it."""
        return Score(self.truth, self.diagnoses[-1:])

    @property
    def hidden(self) -> frozenset[str]:
        return frozenset(self.truth["names"])

    @property
    def named(self) -> frozenset[str]:
        """Effects that are said to be there."""
        stated = self.diagnosis["verdict"] == "named"
        return frozenset(effect["effect"] for effect in self.diagnosis["effects"]) if stated else frozenset()

    @property
    def tie_set(self) -> frozenset[str]:
        """Effects of which one may be there, those that are said to be there included."""
        effects = {effect["effect"] for effect in self.diagnosis["effects"]}
        return frozenset(effects | set(self.diagnosis["candidates"]))

    @property
    def outcome(self) -> Outcome:
        verdict, kind = self.diagnosis["verdict"], Kind(self.truth["kind"])
        if verdict in ("none", "untestable"):
            return Outcome.RIGHT if kind is Kind.NONE else Outcome.MISSED
        if verdict == "unknown":
            return Outcome.RIGHT if kind is Kind.OUTSIDE else Outcome.UNKNOWN
        if verdict == "ambiguous":
            return Outcome.TIE if self.hidden and self.hidden <= self.tie_set else Outcome.WRONG
        if self.named == self.hidden:
            return Outcome.RIGHT
        if self.named < self.hidden:
            return Outcome.PART
        return Outcome.MORE if self.hidden and self.hidden < self.named else Outcome.WRONG

    @property
    def expected(self) -> bool:
        """Right; of what only a known mass tells apart: a tie, and that mass asked for."""
        if self.hidden & set(BY_TEST_MASS):
            asked: Document = self.diagnosis["next_experiment"] or {"kind": ""}
            return self.outcome is Outcome.TIE and "mass" in str(asked["kind"])
        return self.outcome is Outcome.RIGHT

    @property
    def detected(self) -> bool:
        return self.diagnosis["verdict"] not in ("none", "untestable")

    @property
    def in_tie_set(self) -> bool:
        return self.detected and self.hidden <= self.tie_set

    @property
    def not_excluded(self) -> bool:
        """In the tie-set; or nothing found, the effect among those that the sweeps cannot show, and more asked for."""
        unseen = self.hidden <= set(self.diagnosis["untestable"]) and self.diagnosis["next_experiment"] is not None
        return self.in_tie_set or (not self.detected and unseen)

    @property
    def experiments(self) -> list[Document]:
        """Those that were run, in their order."""
        return [diagnosis["next_experiment"] for diagnosis in self.diagnoses[:-1]]

    @property
    def gap(self) -> float | None:
        """Held-out gap after over the noise floor."""
        gap = self.diagnosis["gap"]
        return gap["after_rms"] / gap["noise_floor_rms"] if gap and gap["noise_floor_rms"] else None

    @property
    def errors(self) -> dict[str, float]:
        """(stated - true) / standard deviation of every parameter whose truth is known; of effects named rightly."""
        if self.outcome is not Outcome.RIGHT:
            return {}
        stated = {effect["effect"]: effect["parameters"] for effect in self.diagnosis["effects"]}
        return {
            f"{name}: {key}": (stated[name][key]["value"] - value) / stated[name][key]["std"]
            for name, parameters in self.truth["parameters"].items()
            if name in stated
            for key, value in parameters.items()
            if key in stated[name] and stated[name][key]["std"]
        }


def rate(scores: Sequence[Score], test: Callable[[Score], bool]) -> float | None:
    """Per cent of the scores; None of none."""
    return 100.0 * sum(map(test, scores)) / len(scores) if scores else None


def figures(scores: Sequence[Score]) -> dict[str, float | int | None]:
    """The figures by which a diagnosis is judged; rates in per cent."""
    of = {kind: [score for score in scores if score.truth["kind"] == kind.value] for kind in Kind}
    single = of[Kind.SINGLE]
    gaps = [score.gap for score in single if score.named and score.gap is not None]
    errors = np.abs([error for score in scores for error in score.errors.values()])
    seconds = [float(score.diagnosis["seconds"]) for score in scores]
    machine = [sum(float(experiment["seconds"]) for experiment in score.experiments) for score in single]
    weighed = [score for score in single if score.hidden & set(BY_TEST_MASS)]
    return {
        "single_cases": len(single),
        "detected": rate(single, lambda s: s.detected),
        "right_name": rate(single, lambda s: s.expected),
        "in_tie_set": rate(single, lambda s: s.in_tie_set),
        "not_excluded": rate(single, lambda s: s.not_excluded),
        "wrong_name": rate(single, lambda s: s.outcome in (Outcome.WRONG, Outcome.MORE)),
        "called_unknown": rate(single, lambda s: s.outcome is Outcome.UNKNOWN),
        "right_after_experiments": rate(single, lambda s: s.last.outcome is Outcome.RIGHT),
        "right_after_test_mass": rate(weighed, lambda s: s.last.outcome is Outcome.RIGHT),
        "none_cases": len(of[Kind.NONE]),
        "false_alarms": sum(score.detected for score in of[Kind.NONE]),
        "outside_cases": len(of[Kind.OUTSIDE]),
        "outside_unknown": rate(of[Kind.OUTSIDE], lambda s: s.outcome is Outcome.RIGHT),
        "pair_cases": len(of[Kind.PAIR]),
        "pairs_exact": rate(of[Kind.PAIR], lambda s: s.outcome is Outcome.RIGHT),
        "gap_over_noise_floor": float(np.median(gaps)) if gaps else None,
        "parameters": len(errors),
        "parameters_within_two_std": 100.0 * float(np.mean(errors < 2)) if len(errors) else None,
        "parameters_within_three_std": 100.0 * float(np.mean(errors < 3)) if len(errors) else None,
        "experiments": sum(len(score.experiments) for score in single),
        "machine_seconds_median": float(np.median([m for m in machine if m])) if any(machine) else None,
        "machine_seconds_longest": max(machine, default=0.0) or None,
        "seconds_median": float(np.median(seconds)) if seconds else None,
        "seconds_longest": max(seconds) if seconds else None,
    }


def kinds(scores: Sequence[Score]) -> dict[str, dict[str, float]]:
    """Experiments that were run, by kind: how many, and their machine time, s."""
    found: dict[str, list[float]] = {}
    for experiment in (one for score in scores for one in score.experiments):
        found.setdefault(str(experiment["kind"]), []).append(float(experiment["seconds"]))
    return {
        kind: {"count": len(times), "median": float(np.median(times)), "sum": sum(times)}
        for kind, times in sorted(found.items(), key=lambda item: -len(item[1]))
    }


def intervals(scores: Sequence[Score]) -> dict[str, dict[str, int]]:
    """By parameter: how many were stated, and how many truths lie within two and three standard deviations."""
    found: dict[str, list[float]] = {}
    for score in scores:
        for name, error in score.errors.items():
            found.setdefault(name, []).append(abs(error))
    return {
        name: {"stated": len(errors), "two": sum(e < 2 for e in errors), "three": sum(e < 3 for e in errors)}
        for name, errors in sorted(found.items())
    }


def outcomes(scores: Sequence[Score]) -> dict[str, Counter[str]]:
    """How often each outcome came of what was hidden."""
    table: dict[str, Counter[str]] = {}
    for score in scores:
        table.setdefault(" + ".join(score.truth["names"]) or "none", Counter())[score.outcome.value] += 1
    return table


def confusion(scores: Sequence[Score]) -> dict[str, Counter[str]]:
    """How often one hidden effect (or none, or one outside the catalogue) was given each name.

    Where several are named, an effect that is not there counts before the one that is.
    """
    table: dict[str, Counter[str]] = {name: Counter() for name in ("none", *CATALOGUE, *OUTSIDE)}
    for score in scores:
        if Kind(score.truth["kind"]) is Kind.PAIR:
            continue
        ((name,)) = score.truth["names"] or ("none",)
        others = sorted(score.named - score.hidden) or sorted(score.named) or [score.diagnosis["verdict"]]
        table[name][others[0]] += 1
    return {name: counts for name, counts in table.items() if counts}
