"""The diagnosis of one axis: locate the gap, name the effects, prove them on held-out sweeps, ask for what is missing.

The model to start from is rigid: inertia free in each pose within its prior, viscous friction within its prior, gravity
as CAD has it. Everything else is an effect; those that the axis is `known` to have are fitted with the base.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.calibration import Weighed, corrected, is_decided, is_wrong, weighed_gain
from service.diagnosis.effects import CATALOGUE
from service.diagnosis.equations import equations, grouped
from service.diagnosis.example import Example, example
from service.diagnosis.experiments import TEST_MASS, NextExperiment, next_experiment
from service.diagnosis.gap import Gap, gap
from service.diagnosis.locate import Cell, cells, lines, sentences
from service.diagnosis.parameters import Parameter
from service.diagnosis.patch import Patch
from service.diagnosis.periods import in_periods
from service.diagnosis.select import Selection, select
from service.diagnosis.show import Fit, Fitted, show
from service.diagnosis.signals import tracks
from service.diagnosis.verdict import Verdict, judge, tie_set
from service.diagnosis.visibility import untestable
from service.errors import BadInput
from service.identification.nominal_priors import TorqueGain
from service.recording import Sweep
from service.robot import Robot

Array = NDArray[np.float64]

GAIN = "torque_constant_error"
HEAVIER = "The mass that was weighed is too light to decide it: take a heavier one, or bolt it further out."
OFF = "The test mass is to be off."


@dataclass(frozen=True)
class NamedEffect:
    """An effect that is there: parameters with their covariance, what it adds to a scenario, and what it gains, in
    units of the noise.
    """

    name: str
    parameters: dict[str, Parameter]
    covariance: Array
    patch: Patch | None
    gain: float
    criterion_gain: float


@dataclass(frozen=True)
class AxisDiagnosis:
    """Everything a diagnosis has to say of an axis."""

    joint: str
    unit: str  # of its effort
    verdict: Verdict
    effects: tuple[NamedEffect, ...]
    known: tuple[NamedEffect, ...]
    candidates: tuple[str, ...]
    rivals: tuple[tuple[str, float], ...]  # by how much of Schwarz's criterion each is behind
    rolled_back: tuple[str, ...]
    cells: tuple[Cell, ...]
    sentences: tuple[str, ...]
    gap: Gap
    source: str  # of the gap: "twin" or "columns"
    example: Example
    poses: tuple[tuple[float, ...], ...]
    fit: Fit
    weighed: bool  # a test mass put the torques right
    unexplained: float  # part of the repeatable excess
    next_experiment: NextExperiment | None
    untestable: tuple[str, ...]


def diagnose_axis(
    robot: Robot,
    joint: str,
    sweeps: Sequence[Sweep],
    *,
    known: Sequence[str] = (),
    weighed: Weighed | None = None,
    twin: bool = True,
) -> AxisDiagnosis:
    """Diagnose `joint` from its sweeps; BadInput if none of them moves or an effect of `known` is not in the catalogue.

    `weighed`: some of the sweeps again with a known test mass. A gain that is not one is named a wrong torque constant,
    and the rest diagnosed with it put right; one that is leaves what else pulls.
    `twin`: the gap is what the simulator leaves; else what the linear columns do, which is quicker.
    """
    for name in known:
        if name not in CATALOGUE:
            raise BadInput(name, f"unknown effect; there are {', '.join(CATALOGUE)}")
    gain = None if weighed is None else weighed_gain(robot, joint, sweeps, weighed)
    wrong = gain is not None and is_wrong(gain)
    calibrated = gain is not None and is_decided(gain)
    told = [name for name in known if name != GAIN] if calibrated else known
    own = in_periods(joint, corrected(sweeps, gain) if gain and wrong else sweeps)
    motion = tracks(robot, joint, own)
    given = equations(motion, grouped(motion))
    applying = [name for name, effect in CATALOGUE.items() if name not in told and effect.applies(motion)]
    if calibrated:
        applying = [name for name in applying if name != GAIN]
    selection = select(given, told, applying)
    chosen = selection.chosen
    hidden = untestable(selection.given, [name for name in applying if name not in chosen.names], own)
    verdict = judge(selection, told, [name for name in applying if name not in hidden])
    added = [term for term in chosen.terms if term.effect not in told]
    fixed = [term for term in chosen.terms if term.effect in told]
    ties = tie_set(selection, told, applying) if added else set[str]()
    # an unknown effect is never patched: the model stays what it was
    shown = show(selection.given, own, fixed, [] if verdict is Verdict.UNKNOWN else added, twin=twin)
    if shown.rolled_back and len(shown.fitted) == len(fixed):
        verdict = Verdict.UNKNOWN
    found = gap(selection.given, shown.before, shown.after)
    groups, noise = selection.given.groups, found.noise_floor_rms
    where = (*lines(motion, shown.before, shown.after), *cells(motion, groups, shown.before, shown.after, noise))
    effects = [_named(one, selection) for one in shown.fitted]
    named = [effect for effect in effects if effect.name not in told]
    if gain and wrong and GAIN not in known and verdict is not Verdict.UNKNOWN:
        named = [_wrong(gain), *named]
        verdict = Verdict.AMBIGUOUS if verdict is Verdict.AMBIGUOUS else Verdict.NAMED
    rivals = tuple(sorted(ties)) if verdict is Verdict.AMBIGUOUS else ()
    wanted = next_experiment(selection, verdict, rivals, hidden, own)
    if wanted is not None and weighed is not None:
        wanted = replace(wanted, reason=f"{wanted.reason} {HEAVIER if wanted.kind == TEST_MASS else OFF}")
    return AxisDiagnosis(
        joint=joint,
        unit="N" if robot.chain.joints[robot.index(joint)].kind == "prismatic" else "N m",
        verdict=verdict,
        effects=tuple(named),
        known=tuple(effect for effect in effects if effect.name in told),
        candidates=rivals,
        rivals=_behind(selection),
        rolled_back=shown.rolled_back,
        cells=tuple(sorted(where, key=lambda cell: -cell.significance)),
        sentences=(*sentences(joint, where), *shown.sentences),
        gap=found,
        source=shown.source,
        example=example(selection.given, shown.before, shown.after),
        poses=tuple(tuple(pose) for pose in motion.poses.tolist()),
        fit=shown.fit,
        weighed=wrong,
        unexplained=selection.unexplained,
        next_experiment=wanted,
        untestable=(*hidden, *(name for name, e in CATALOGUE.items() if name not in told and not e.applies(motion))),
    )


def _named(one: Fitted, selection: Selection) -> NamedEffect:
    rigid, chosen = selection.rigid, selection.chosen
    gains = (rigid.cost - chosen.cost, rigid.criterion - chosen.criterion)
    return NamedEffect(one.effect, one.parameters, one.covariance, one.patch, *gains)


def _behind(selection: Selection) -> tuple[tuple[str, float], ...]:
    """Every other explanation by the effect that is another in it, the nearest first."""
    behind: dict[str, float] = {}
    for tried in sorted(selection.tried, key=lambda one: one.criterion):
        behind.setdefault(tried.terms[-1].effect, tried.criterion - selection.chosen.criterion)
    return tuple(behind.items())


def _wrong(gain: TorqueGain) -> NamedEffect:
    """The torque constant's error as a mass tells it."""
    squares, error = ((gain.gain - 1) / gain.std) ** 2, gain.gain - 1
    parameters = {"gain_error": Parameter(error, gain.std, "")}
    patch: Patch = {"train": {"effort_gain": error}}
    return NamedEffect(GAIN, parameters, np.array([[gain.std**2]]), patch, squares, squares)
