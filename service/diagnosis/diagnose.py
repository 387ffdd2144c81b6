"""The diagnosis of one axis: locate the gap, name the effects, prove them on held-out sweeps, ask for what is missing.

The model to start from is rigid: inertia free in each pose within its prior, viscous friction within its prior, gravity
as CAD has it. Everything else is an effect; those that the axis is `known` to have are fitted with the base.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.calibration import Weighed, corrected, is_decided, is_wrong, weighed_gain
from service.diagnosis.effects import CATALOGUE
from service.diagnosis.equations import equations, grouped
from service.diagnosis.example import Example, example
from service.diagnosis.experiments import TEST_MASS, NextExperiment, next_experiment
from service.diagnosis.gap import Gap, gap, noise
from service.diagnosis.locate import Cell, cells, lines, sentences
from service.diagnosis.parameters import Parameter
from service.diagnosis.patch import Patch
from service.diagnosis.periods import in_periods
from service.diagnosis.select import Selection, select
from service.diagnosis.show import Fit, Fitted, Shown, show
from service.diagnosis.signals import tracks
from service.diagnosis.verdict import Verdict, explains, judge, share, tie_sets, without
from service.diagnosis.visibility import untestable
from service.errors import BadInput
from service.identification.nominal_priors import TorqueGain
from service.recording import Sweep
from service.robot import Robot

Array = NDArray[np.float64]
Known = Mapping[str, Mapping[str, Parameter]]

NOTHING: Known = {}
CHANGED = 4.0  # standard deviations by which a parameter of the model is another now
GAIN, GAIN_ERROR = "torque_constant_error", "gain_error"
HEAVIER = "The mass that was weighed is too light to decide it: take a heavier one, or bolt it further out."
OFF = "The test mass is to be off."


@dataclass(frozen=True)
class NamedEffect:
    """An effect that is there: parameters with their covariance, what it adds to a scenario, and what it gains beside
    the others, in units of the noise.
    """

    name: str
    parameters: dict[str, Parameter]
    covariance: Array
    patch: Patch | None
    gain: float
    criterion_gain: float


@dataclass(frozen=True)
class Change:
    """A parameter of a known effect that is another now: what the model says of it, and what these sweeps say."""

    effect: str
    parameter: str
    model: Parameter
    now: Parameter


@dataclass(frozen=True)
class AxisDiagnosis:
    """Everything a diagnosis has to say of an axis."""

    joint: str
    unit: str  # of its effort
    verdict: Verdict
    effects: tuple[NamedEffect, ...]
    known: tuple[NamedEffect, ...]
    changes: tuple[Change, ...]  # of the known ones
    alternatives: tuple[tuple[str, ...], ...]  # of each effect it and who explains as much in its place, if ambiguous
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

    @property
    def candidates(self) -> tuple[str, ...]:
        """Who may be behind the gap while that is not decided."""
        return tuple(sorted({name for names in self.alternatives for name in names}))


def diagnose_axis(
    robot: Robot,
    joint: str,
    sweeps: Sequence[Sweep],
    *,
    known: Known = NOTHING,
    weighed: Weighed | None = None,
    twin: bool = True,
) -> AxisDiagnosis:
    """Diagnose `joint` from its sweeps; BadInput if none of them moves or an effect of `known` is not in the catalogue.

    `known`: effects that the model has, with what it says of their parameters as far as it does. One that this axis
    cannot have, as gravity on an upright axis, is left out.
    `weighed`: some of the sweeps again with a known test mass. A gain that is not one is named a wrong torque constant,
    and the rest diagnosed with it put right; one that is leaves what else pulls.
    `twin`: the gap is what the simulator leaves; else what the linear columns do, which is quicker.
    """
    for name in known:
        if name not in CATALOGUE:
            raise BadInput(name, f"unknown effect; there are {', '.join(CATALOGUE)}")
    gain = _accepted(known) if weighed is None else weighed_gain(robot, joint, sweeps, weighed)
    wrong = gain if gain is not None and is_wrong(gain) else None
    calibrated = gain is not None and is_decided(gain)
    own = in_periods(joint, corrected(sweeps, wrong) if wrong else sweeps)
    motion = tracks(robot, joint, own)
    given = equations(motion, grouped(motion))
    possible = [
        name for name, effect in CATALOGUE.items() if effect.applies(motion) and not (calibrated and name == GAIN)
    ]
    told = [name for name in known if name in possible]
    applying = [name for name in possible if name not in told]
    selection = select(given, told, applying)
    hidden = untestable(selection.given, [name for name in applying if name not in selection.chosen.names], own)
    testable = [name for name in applying if name not in hidden]
    verdict, shown = _shown(selection, judge(selection, told, testable), own, told, twin=twin)
    ties = tie_sets(selection, told, applying) if verdict is Verdict.AMBIGUOUS else {}
    before = shown.before
    if wrong and GAIN not in known:  # the gap is that of the effort as the drive told it
        before = _as_told(robot, joint, sweeps, selection, told, twin=twin)
    found = gap(selection.given, before, shown.after, held_out=shown.held_out)
    where = (
        *lines(motion, before, shown.after),
        *cells(motion, selection.given.groups, before, shown.after, noise(selection.given, shown.after)),
    )
    effects = [_named(one, selection) for one in shown.fitted]
    named = [effect for effect in effects if effect.name not in told]
    base = [effect for effect in effects if effect.name in told]
    if gain and calibrated and (wrong or GAIN in known):
        (base if GAIN in known else named).insert(0, _weighed(gain))
        if verdict in (Verdict.NONE, Verdict.UNTESTABLE) and GAIN not in known:
            verdict = Verdict.NAMED
    wanted = next_experiment(selection, verdict, tuple(sorted({*ties, *chain(*ties.values())})), hidden, own)
    if wanted is not None and weighed is not None:
        wanted = replace(wanted, reason=f"{wanted.reason} {HEAVIER if wanted.kind == TEST_MASS else OFF}")
    return AxisDiagnosis(
        joint=joint,
        unit="N" if robot.chain.joints[robot.index(joint)].kind == "prismatic" else "N m",
        verdict=verdict,
        effects=tuple(named),
        known=tuple(base),
        changes=_changes(known, base),
        alternatives=tuple((name, *sorted(rivals)) for name, rivals in ties.items()),
        rivals=_behind(selection),
        rolled_back=shown.rolled_back,
        cells=tuple(sorted(where, key=lambda cell: -cell.significance)),
        sentences=(*sentences(joint, where), *shown.sentences),
        gap=found,
        source=shown.source,
        example=example(selection.given, before, shown.after),
        poses=tuple(tuple(pose) for pose in motion.poses.tolist()),
        fit=shown.fit,
        weighed=wrong is not None,
        unexplained=selection.unexplained,
        next_experiment=wanted,
        untestable=(
            *hidden,
            *(name for name in CATALOGUE if name not in known and not CATALOGUE[name].applies(motion)),
        ),
    )


def _shown(
    selection: Selection, verdict: Verdict, sweeps: Sequence[Sweep], known: Sequence[str], *, twin: bool
) -> tuple[Verdict, Shown]:
    """What held-out sweeps leave, and the verdict after it: what they do not bear out explains nothing.

    An unknown effect is never patched: the model stays what it was.
    """
    fixed = [term for term in selection.chosen.terms if term.effect in known]
    added = [term for term in selection.chosen.terms if term.effect not in known]
    if verdict is not Verdict.UNKNOWN:
        shown = show(selection.given, sweeps, fixed, added, twin=twin)
        left = without(selection, shown.rolled_back) if shown.rolled_back else selection
        if not shown.rolled_back or (len(left.chosen.terms) > len(fixed) and explains(left, known)):
            return verdict, shown
        return Verdict.UNKNOWN, replace(
            show(selection.given, sweeps, fixed, [], twin=twin), rolled_back=shown.rolled_back
        )
    return verdict, show(selection.given, sweeps, fixed, [], twin=twin)


def _as_told(
    robot: Robot, joint: str, sweeps: Sequence[Sweep], selection: Selection, known: Sequence[str], *, twin: bool
) -> Array:
    """What the model without any new effect leaves (n, rows) of the effort that the drive told."""
    own = in_periods(joint, sweeps)
    given = equations(tracks(robot, joint, own), selection.given.groups)
    fixed = [term for term in selection.chosen.terms if term.effect in known]
    return show(given, own, fixed, [], twin=twin).before


def _named(one: Fitted, selection: Selection) -> NamedEffect:
    term = next(term for term in selection.chosen.terms if term.effect == one.effect)
    return NamedEffect(one.effect, one.parameters, one.covariance, one.patch, *share(selection, term))


def _changes(known: Known, now: Sequence[NamedEffect]) -> tuple[Change, ...]:
    """Parameters that differ by more than both standard deviations allow."""
    return tuple(
        Change(effect.name, name, model, effect.parameters[name])
        for effect in now
        for name, model in known[effect.name].items()
        if name in effect.parameters
        and abs(effect.parameters[name].value - model.value)
        > CHANGED * np.hypot(effect.parameters[name].std, model.std)
    )


def _behind(selection: Selection) -> tuple[tuple[str, float], ...]:
    """Every other explanation by the effect that is another in it, the nearest first."""
    behind: dict[str, float] = {}
    for tried in sorted(selection.tried, key=lambda one: one.criterion):
        behind.setdefault(tried.terms[-1].effect, tried.criterion - selection.chosen.criterion)
    return tuple(behind.items())


def _accepted(known: Known) -> TorqueGain | None:
    """The torque gain that the model has: sweeps do not tell it from a load, so it is held until a mass is weighed."""
    error = known.get(GAIN, {}).get(GAIN_ERROR)
    return None if error is None else TorqueGain(1 + error.value, error.std)


def _weighed(gain: TorqueGain) -> NamedEffect:
    """The torque constant's error as a mass tells it."""
    squares, error = ((gain.gain - 1) / gain.std) ** 2, gain.gain - 1
    parameters = {GAIN_ERROR: Parameter(error, gain.std, "")}
    patch: Patch = {"train": {"effort_gain": error}}
    return NamedEffect(GAIN, parameters, np.array([[gain.std**2]]), patch, squares, squares)
