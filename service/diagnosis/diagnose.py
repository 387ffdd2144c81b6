"""The diagnosis of one axis: locate the gap, name the effects, prove them on held-out sweeps, ask for what is missing.

The model to start from is rigid: inertia free in each pose within its prior, viscous friction within its prior, gravity
as CAD has it. Everything else is an effect; those that the axis is `known` to have are fitted with the base.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from service.diagnosis.effects import CATALOGUE
from service.diagnosis.equations import equations, grouped
from service.diagnosis.experiments import NextExperiment, next_experiment
from service.diagnosis.gap import Gap, gap, residual
from service.diagnosis.locate import Cell, cells, lines, sentences
from service.diagnosis.parameters import Parameter, parameters
from service.diagnosis.periods import in_periods
from service.diagnosis.select import select
from service.diagnosis.signals import tracks
from service.diagnosis.verdict import Verdict, judge, tie_set, untestable
from service.errors import BadInput
from service.recording import Sweep
from service.robot import Robot

MOST_CELLS = 40


@dataclass(frozen=True)
class NamedEffect:
    """An effect that is there: its parameters, its words, and what it gains, in units of the noise."""

    name: str
    parameters: dict[str, Parameter]
    sentence: str
    gain: float
    criterion_gain: float


@dataclass(frozen=True)
class AxisDiagnosis:
    """Everything a diagnosis has to say of an axis."""

    joint: str
    verdict: Verdict
    effects: tuple[NamedEffect, ...]
    candidates: tuple[str, ...]
    cells: tuple[Cell, ...]
    sentences: tuple[str, ...]
    gap: Gap
    unexplained: float  # part of the repeatable excess
    next_experiment: NextExperiment | None
    untestable: tuple[str, ...]


def diagnose_axis(
    robot: Robot, joint: str, sweeps: Sequence[Sweep], *, known: Sequence[str] = (), gain_calibrated: bool = False
) -> AxisDiagnosis:
    """Diagnose `joint` from its sweeps; BadInput if none of them moves or an effect of `known` is not in the catalogue.

    `gain_calibrated`: a known test mass fixed the torque gain, so a payload can be told from a wrong torque constant.
    """
    for name in known:
        if name not in CATALOGUE:
            raise BadInput(name, f"unknown effect; there are {', '.join(CATALOGUE)}")
    motion = tracks(robot, joint, in_periods(joint, sweeps))
    given = equations(motion, grouped(motion))
    applying = [name for name, effect in CATALOGUE.items() if name not in known and effect.applies(motion)]
    if gain_calibrated:
        applying = [name for name in applying if name != "torque_constant_error"]
    hidden = untestable(given, applying)
    testable = [name for name in applying if name not in hidden]
    selection = select(given, known, testable)
    chosen = selection.chosen
    verdict = judge(selection, known, testable, calibrated=gain_calibrated)
    added = [term for term in chosen.terms if term.effect not in known]
    fixed = [term for term in chosen.terms if term.effect in known]
    ties = tie_set(selection, known, testable, calibrated=gain_calibrated) if added else set[str]()
    # an unknown effect is never patched: the model stays what it was
    proven = list(chosen.terms) if verdict is not Verdict.UNKNOWN else fixed
    found = gap(selection.given, fixed, proven)
    before = residual(selection.given, fixed)
    where = (*lines(motion, before), *cells(motion, selection.given.groups, before, found.noise_floor_rms))
    values = parameters(selection.given, chosen.terms) if chosen.terms else []
    named = [
        NamedEffect(
            term.effect,
            value,
            CATALOGUE[term.effect].sentence,
            selection.rigid.cost - chosen.cost,
            selection.rigid.criterion - chosen.criterion,
        )
        for term, value in zip(chosen.terms, values, strict=True)
        if term in added and verdict in (Verdict.NAMED, Verdict.AMBIGUOUS)
    ]
    rivals = tuple(sorted(ties)) if verdict is Verdict.AMBIGUOUS else ()
    return AxisDiagnosis(
        joint=joint,
        verdict=verdict,
        effects=tuple(named),
        candidates=rivals,
        cells=tuple(sorted(where, key=lambda cell: -cell.significance)[:MOST_CELLS]),
        sentences=sentences(joint, where),
        gap=found,
        unexplained=selection.unexplained,
        next_experiment=next_experiment(selection, verdict, rivals, hidden),
        untestable=(*hidden, *(name for name, e in CATALOGUE.items() if name not in known and not e.applies(motion))),
    )
