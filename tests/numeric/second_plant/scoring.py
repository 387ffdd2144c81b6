"""Truth against what a diagnosis said: what came of a case, and figures and tables of many. No physics here."""

import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np

from service.diagnosis.experiments import TEST_MASS
from tests.numeric.second_plant.cases import Kind
from tests.numeric.second_plant.effects import BY_TEST_MASS

Document = dict[str, Any]

BIG = ("medium", "large")

SEEN_AS = {"tilted_base": frozenset({"gravity_error"}), "counterbalance": frozenset({"counterbalance"})}
"""What is drawn as outside of the catalogue, and a name that is true of it: no mass explains a base that leans."""

FAULT_WORDS: dict[str, tuple[str, ...]] = {
    "gear_ratio_off": ("gear_ratio", "gear ratio"),
    "ripple_orders_missing": ("ripple", "order"),
    "axes_swapped": ("axis", "axes"),
    "torque_sign": ("sign",),
    "speed_scaled": ("velocity", "speed"),
    "torque_clipped": ("clip", "saturat"),
    "torque_8_bit": ("quanti", "resolution", "step"),
    "torque_spikes": ("spike", "outlier"),
    "effort_in_percent": ("unit", "percent", "scale"),
    "effort_in_n_mm": ("unit", "mm", "scale"),
    "position_in_degrees": ("unit", "degree"),
    "channels_apart": ("delay", "late", "apart"),
    "clock_jumps": ("clock", "jump", "time"),
    "repeats_unlike": ("repeat",),
}
"""One of which must stand in a finding's name, or where it has none in its words, that the fault counts as told."""


class Outcome(Enum):
    """What a diagnosis made of a case."""

    RIGHT = "right"  # all that is hidden named and nothing else but what comes with it; none; unknown; the fault told
    TIE = "tie"  # ambiguous, the truth among the candidates
    PART = "part"  # nothing named that is not there, but not all that is
    WRONG = "wrong"  # a name that is neither hidden nor comes with what is
    UNKNOWN = "unknown"
    MISSED = "missed"  # nothing found
    ERROR = "error"  # it broke off


@dataclass(frozen=True)
class Score:
    """One case. `said`: the axis' document, or {"error": text}, each with "seconds"."""

    truth: Document
    said: Document

    @property
    def kind(self) -> Kind:
        return Kind(self.truth["class"])

    @property
    def hidden(self) -> frozenset[str]:
        return frozenset(self.truth["hidden"]) if self.kind is not Kind.OUTSIDE else frozenset()

    @property
    def allowed(self) -> frozenset[str]:
        return self.hidden | self.seen_as | frozenset(self.truth["companions"])

    @property
    def seen_as(self) -> frozenset[str]:
        """Names that are true of what the catalogue has no entry for."""
        return frozenset[str]().union(*(SEEN_AS.get(name, frozenset[str]()) for name in self.truth["hidden"]))

    @property
    def verdict(self) -> str:
        return "error" if "error" in self.said else str(self.said["verdict"])

    @property
    def named(self) -> frozenset[str]:
        """What is said to be there."""
        return frozenset(e["effect"] for e in self.said["effects"]) if self.verdict == "named" else frozenset()

    @property
    def candidates(self) -> frozenset[str]:
        """Of which one is said to be there."""
        if self.verdict != "ambiguous":
            return frozenset()
        return frozenset(self.said["candidates"]) | {e["effect"] for e in self.said["effects"]}

    @property
    def admitted(self) -> bool:
        """Whether all that is hidden is named, or a candidate."""
        return self.hidden <= self.named | self.candidates

    @property
    def wrong(self) -> frozenset[str]:
        """Names that are not there; of candidates all, where none of them is."""
        if self.candidates:
            return frozenset() if self.candidates & self.allowed else self.candidates
        return self.named - self.allowed

    @property
    def wrong_in_part(self) -> frozenset[str]:
        """Names told beside an unknown rest that are not there."""
        told = self.said.get("part") or []
        return frozenset(p["effect"] if isinstance(p, Mapping) else str(p) for p in told) - self.allowed

    @property
    def findings(self) -> list[Any]:
        return list(self.said.get("data") or [])

    @property
    def outcome(self) -> Outcome:
        if self.verdict == "error":
            return Outcome.ERROR
        if self.wrong:
            return Outcome.WRONG
        if self.kind is Kind.NOMINAL:
            return Outcome.RIGHT if told(self.truth["fault"], self.findings) else Outcome.MISSED
        if self.verdict in ("none", "untestable"):
            return Outcome.RIGHT if self.kind is Kind.NONE else Outcome.MISSED
        if self.verdict == "unknown":
            return Outcome.RIGHT if self.kind is Kind.OUTSIDE else Outcome.UNKNOWN
        if self.kind is Kind.OUTSIDE and self.named and self.named <= self.seen_as:
            return Outcome.RIGHT
        if self.verdict == "ambiguous":
            return self._of_ties()
        return Outcome.RIGHT if self.hidden and self.hidden <= self.named else Outcome.PART

    def _of_ties(self) -> Outcome:
        asked: Document = self.said.get("next_experiment") or {"kind": ""}
        if self.hidden & set(BY_TEST_MASS):
            return Outcome.RIGHT if asked["kind"] == TEST_MASS and self.hidden <= self.candidates else Outcome.TIE
        if self.kind is Kind.NONE:
            return Outcome.WRONG
        return Outcome.TIE if self.hidden <= self.candidates else Outcome.PART

    @property
    def gap(self) -> float | None:
        """What is left over the noise floor, of what was named."""
        gap = self.said.get("gap")
        return gap["after_rms"] / gap["noise_floor_rms"] if gap and self.named and gap["noise_floor_rms"] else None

    @property
    def parameters(self) -> dict[str, float]:
        """How many standard deviations a stated parameter is off, where the truth has the same one."""
        stated = {e["effect"]: e["parameters"] for e in self.said.get("effects", ())}
        return {
            f"{effect}: {key}": (stated[effect][key]["value"] - value) / stated[effect][key]["std"]
            for effect, key, value in same_parameters(self.truth["hidden"])
            if effect in stated and stated[effect].get(key, {}).get("std")
        }


def told(fault: str, findings: Sequence[Any]) -> bool:
    """Whether one of the findings speaks of the fault."""

    def words(finding: Any) -> str:
        if not isinstance(finding, Mapping):
            return str(finding).lower()
        name = next((str(finding[key]) for key in ("fault", "name", "kind", "code") if finding.get(key)), "")
        return (name or json.dumps(finding)).lower()

    texts = [words(finding) for finding in findings]
    return any(text == fault or any(word in text for word in FAULT_WORDS[fault]) for text in texts)


def same_parameters(hidden: Mapping[str, Document]) -> Iterator[tuple[str, str, float]]:
    """(effect, name in the catalogue, true value): only where both mean the same quantity."""
    for effect, p in hidden.items():
        found: dict[str, float | None] = {}
        if effect == "coulomb_friction":
            found = {"coulomb": p["level"]}
        elif effect == "asymmetric_friction":
            found = {"coulomb": (p["forward"] + p["backward"]) / 2}
            found["coulomb_difference"] = (p["forward"] - p["backward"]) / 2
        elif effect == "stribeck_friction" and p["law"] == "exponential":
            found = {"coulomb": p["sliding"], "extra": p["static"] - p["sliding"], "velocity": p["velocity"]}
            found["exponent"] = p["exponent"]
        elif effect == "nonlinear_viscous_friction":
            found = {"exponent": p["exponent"]}
        elif effect == "load_dependent_friction" and p["law"] == "sum":
            found = {"coulomb": p["level"], "load_dependence": p["load_share"]}
        elif effect == "hose_spring" and p["hardening"] == 0:
            found = {"stiffness": p["stiffness"]}
        elif effect == "joint_elasticity" and p["hardening"] == 0:
            found = {"compliance": 1 / p["stiffness"]}
        elif effect == "measurement_delay" and p["law"] == "pure":
            found = {"delay": p["delay"]}
        elif effect == "effort_offset" and p["drift"] == 0:
            found = {"offset": p["offset"]}
        elif effect == "cogging_torque":
            for order, size, phase in zip(p["orders"], p["amplitudes"], p["phases"], strict=True):
                found |= {f"sine_{order:g}": size * np.cos(phase), f"cosine_{order:g}": size * np.sin(phase)}
        elif effect == "counterbalance":
            found = {"share": p.get("share")}
        elif effect in ("payload", "torque_constant_error", "backlash"):
            key = {"payload": "mass", "torque_constant_error": "gain_error", "backlash": "play"}[effect]
            found = {key: p[key]}
        yield from ((effect, key, float(value)) for key, value in found.items() if value is not None)


def rate(scores: Sequence[Score], test: Callable[[Score], bool]) -> float | None:
    """Per cent of the scores; None of none."""
    return 100.0 * sum(map(test, scores)) / len(scores) if scores else None


def figures(scores: Sequence[Score]) -> dict[str, float | int | None]:
    """The figures by which a diagnosis is judged; rates in per cent."""
    of = {kind: [score for score in scores if score.kind is kind] for kind in Kind}
    big = [score for score in of[Kind.SINGLE] if score.truth["size"] in BIG]
    small = [score for score in of[Kind.SINGLE] if score.truth["size"] not in BIG]
    gaps = [score.gap for score in scores if score.gap is not None]
    off = np.abs([error for score in scores for error in score.parameters.values()])
    seconds = [float(score.said["seconds"]) for score in scores]
    physics = [score for score in scores if score.kind is not Kind.NOMINAL]
    found: dict[str, float | int | None] = {f"{kind.value}_cases": len(of[kind]) for kind in Kind}
    return found | {
        "big_cases": len(big),
        "small_cases": len(small),
        "experiment_proposed": rate(
            [s for s in physics if s.verdict not in ("none", "named", "error")],
            lambda s: bool(s.said.get("next_experiment")),
        ),
        "errors": sum(score.outcome is Outcome.ERROR for score in scores),
        "right_name": rate(big, lambda s: s.outcome is Outcome.RIGHT),
        "wrong_name": rate(big, lambda s: bool(s.wrong)),
        "truth_admitted": rate(big, lambda s: s.admitted),
        "called_unknown": rate(big, lambda s: s.outcome is Outcome.UNKNOWN),
        "small_wrong": rate(small, lambda s: bool(s.wrong)),
        "false_alarms": rate(of[Kind.NONE], lambda s: s.verdict not in ("none", "untestable", "error")),
        "outside_unknown": rate(of[Kind.OUTSIDE], lambda s: s.outcome is Outcome.RIGHT),
        "outside_wrong": rate(of[Kind.OUTSIDE], lambda s: bool(s.wrong)),
        "pairs_exact": rate(of[Kind.PAIR], lambda s: s.outcome is Outcome.RIGHT),
        "pairs_wrong": rate(of[Kind.PAIR], lambda s: bool(s.wrong)),
        "triples_wrong": rate(of[Kind.TRIPLE], lambda s: bool(s.wrong)),
        "faults_told": rate(of[Kind.NOMINAL], lambda s: s.outcome is Outcome.RIGHT),
        "sound_with_findings": rate(physics, lambda s: bool(s.findings)),
        "wrong_in_part": rate(physics, lambda s: bool(s.wrong_in_part)),
        "gap_median": float(np.median(gaps)) if gaps else None,
        "gap_95th": float(np.percentile(gaps, 95)) if gaps else None,
        "parameters": len(off),
        "parameters_within_two_std": 100.0 * float(np.mean(off < 2)) if len(off) else None,
        "seconds_median": float(np.median(seconds)) if seconds else None,
        "seconds_longest": max(seconds, default=None),
    }


def label(score: Score) -> str:
    """What was hidden, in words."""
    return score.truth["fault"] or " + ".join(score.truth["hidden"]) or "none"


def outcomes(scores: Sequence[Score]) -> dict[str, Counter[str]]:
    """How often each outcome came of each class."""
    table: dict[str, Counter[str]] = {}
    for score in scores:
        size = f", {score.truth['size']}" if score.kind is Kind.SINGLE else ""
        table.setdefault(score.kind.value + size, Counter())[score.outcome.value] += 1
    return table


def confusion(scores: Sequence[Score]) -> dict[str, Counter[str]]:
    """What was said of each hidden effect, healthy machine, effect outside, fault: wrong names first."""
    table: dict[str, Counter[str]] = {}
    for score in scores:
        if score.kind in (Kind.PAIR, Kind.TRIPLE):
            continue
        said = sorted(score.wrong) or sorted(score.named & score.hidden) or sorted(score.named) or [score.verdict]
        table.setdefault(label(score), Counter())[said[0]] += 1
    return table


def intervals(scores: Sequence[Score]) -> dict[str, dict[str, int]]:
    """By parameter: how many were stated, and how many truths lie within two standard deviations."""
    found: dict[str, list[float]] = {}
    for score in scores:
        for name, error in score.parameters.items():
            key = name.rsplit("_", 1)[0] if "sine_" in name else name
            found.setdefault(key, []).append(abs(error))
    return {name: {"stated": len(e), "two": sum(x < 2 for x in e)} for name, e in sorted(found.items())}


def failed(scores: Sequence[Score]) -> list[str]:
    """A line for every case that did not come out right."""
    lines: list[str] = []
    for score in scores:
        if score.outcome is not Outcome.RIGHT:
            said = score.said.get("error") or ", ".join(sorted(score.named or score.candidates)) or score.verdict
            numbered = f"{score.truth['number']:05} {score.truth['class']} {score.truth['size']}"
            lines.append(f"{numbered} {label(score)} | {score.outcome.value}: {said}")
    return lines
