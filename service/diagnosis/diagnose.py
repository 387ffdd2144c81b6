"""The diagnosis of one axis: locate the gap, name effects, verify them on held-out sweeps, propose the next experiment.

The initial model is rigid: inertia and gravity of all poses and viscous friction, within the prior of the robot.
All other physics are effects. The effects `known` for the axis are fitted together with the rigid model. If there are
enough poses, one is not used to select effects; the gap is then computed on this pose.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from service import BadInput
from service.data_check import DataFinding, check, untrustworthy
from service.diagnosis.effects import CATALOGUE
from service.diagnosis.effects.effect import Patch
from service.diagnosis.experiments import TEST_MASS, NextExperiment, Runnable, all_runnable, next_experiment
from service.diagnosis.fit.calibration import Weighed, corrected, is_decided, is_wrong, weighed_gain
from service.diagnosis.fit.cross_products import NotFinite
from service.diagnosis.fit.equations import Equations, Term, applies, equations, grouped, held_back
from service.diagnosis.fit.fitted import Parameter
from service.diagnosis.fit.gap import gap, noise, noise_floor, residual
from service.diagnosis.fit.search import CurrentModel
from service.diagnosis.fit.select import Selection, allowed_by_physics, select, settled, with_groups
from service.diagnosis.law import Law, proposed_law
from service.diagnosis.localisation.locate import cells, example, lines, sentences
from service.diagnosis.localisation.repeatability import unrepeated
from service.diagnosis.localisation.ripple_search import ripples, with_ripples
from service.diagnosis.model.held_out_check import Fit, Fitted, HeldOutCheck, beside_twin, check_held_out
from service.diagnosis.model.rigid_model import rigid_model
from service.diagnosis.play import PLAY, Play, measured_play
from service.diagnosis.rows.periods import in_periods
from service.diagnosis.rows.signals import SHORTEST, finite_samples, sticking_within, tracks
from service.diagnosis.sensitivity import UntestableEffect, untestable
from service.diagnosis.unfinished import unfinished
from service.diagnosis.verdict import Verdict, at_floor, judge, of_one_record, share, tie_sets, without
from service.identification.axis.nominal_priors import TorqueGain
from service.identification.motion.free_motion import at_once
from service.model import Array, Robot, Sweep
from service.model.results.diagnosis import Cell, Example, Gap, RigidParameter, Unfinished

Known = Mapping[str, Mapping[str, Parameter]]

NOTHING: Known = {}
CHANGED = 4.0  # standard deviations: above, a parameter of the model has changed
GAIN, GAIN_ERROR = "torque_constant_error", "gain_error"
HEAVIER = "The mass that was weighed is too light to decide it: take a heavier one, or bolt it further out."
OFF = "The test mass is to be off."
CAD = "cad"  # initial rigid model without an estimate


@dataclass(frozen=True)
class NamedEffect:
    """A detected effect: its parameters with covariance, its contribution to a scenario, and the decrease of the
    cost when it is added to the other effects, in units of the noise variance.
    """

    name: str
    parameters: dict[str, Parameter]
    covariance: Array
    patch: Patch | None
    gain: float
    criterion_gain: float


@dataclass(frozen=True)
class ParameterChange:
    """A parameter of a known effect that has changed: the value in the model and the value from these sweeps."""

    effect: str
    parameter: str
    model: Parameter
    now: Parameter


@dataclass(frozen=True)
class AxisResult:
    """The complete result of the diagnosis of one axis."""

    joint: str
    unit: str  # of its effort
    verdict: Verdict
    effects: tuple[NamedEffect, ...]
    known: tuple[NamedEffect, ...]
    part: tuple[NamedEffect, ...]  # explains a part of the gap; the rest is unknown
    changes: tuple[ParameterChange, ...]  # of the known effects
    alternatives: tuple[tuple[str, ...], ...]  # if ambiguous: each effect and its equivalent ones
    rivals: tuple[tuple[str, float], ...]  # other explanations, with their difference in Schwarz's criterion
    rolled_back: tuple[str, ...]
    cells: tuple[Cell, ...]
    sentences: tuple[str, ...]
    gap: Gap
    example: Example
    poses: tuple[tuple[float, ...], ...]
    fit: Fit
    rigid_model: tuple[RigidParameter, ...]
    started_from: str  # source of the initial rigid model: "cad", or which estimate
    weighed: bool  # the effort was corrected with a known test mass
    unexplained: float  # part of the repeatable excess
    law: Law | None  # proposed for an unknown gap, in no model
    next_experiment: NextExperiment | None
    ended: str  # why no experiment is left that may decide what is undecided; "": it is decided, or one is left
    untestable: tuple[str, ...]
    biasing: tuple[str, ...]  # those untestable effects that would change the estimate unseen
    data: tuple[DataFinding, ...]  # findings of the data check
    unfinished: tuple[Unfinished, ...]  # searches that used up their steps

    @property
    def candidates(self) -> tuple[str, ...]:
        """The effects that may explain the gap while it is undecided."""
        return tuple(sorted({name for names in self.alternatives for name in names}))


def diagnose_axis(
    robot: Robot,
    joint: str,
    sweeps: Sequence[Sweep],
    *,
    known: Known = NOTHING,
    weighed: Weighed | None = None,
    twin: bool = True,
    experiments: int = 0,
    runnable: Runnable = all_runnable,
) -> AxisResult:
    """Diagnose `joint` from its sweeps. BadInput if no sweep moves, if an effect of `known` is not in the catalogue, or
    with axis and sweep if a sample or a column of an effect is not finite; with the axis if its equations are not.

    `robot`: with the rigid model of CAD or of an estimate (`service.formats.export.started_robot`).

    `known`: effects of the model, with the values of their parameters as far as the model has them. Effects that are
    impossible for this axis (for example gravity on a vertical axis) are ignored.
    `weighed`: some sweeps repeated with a known test mass. A gain other than 1 is named as a wrong torque constant, and
    the effort is corrected before the diagnosis. A gain of 1 excludes a wrong torque constant.
    `twin`: also simulate the identified model; the result contains the RMS of the difference from the measured effort.
    `experiments`: how many were run before this diagnosis; after `MOST_EXPERIMENTS` none is proposed. `runnable`:
    which sweeps of one the machine can run.
    """
    for name in known:
        if name not in CATALOGUE:
            raise BadInput(name, f"unknown effect; there are {', '.join(CATALOGUE)}")
    together = {spec.id for group in at_once([sweep.spec for sweep in sweeps]) for spec in group}
    sweeps = [sweep for sweep in sweeps if sweep.spec.id not in together]  # the equations of one axis do not hold there
    finite_samples(sweep for sweep in sweeps if sweep.spec.axis == joint)
    try:
        return _diagnosed(robot, joint, sweeps, known, weighed, twin=twin, experiments=experiments, runnable=runnable)
    except (NotFinite, np.linalg.LinAlgError) as error:
        raise BadInput(
            joint, f"{error}; its sweeps cannot be diagnosed, check their units and the robot file"
        ) from None


def _diagnosed(
    robot: Robot,
    joint: str,
    sweeps: Sequence[Sweep],
    known: Known,
    weighed: Weighed | None,
    *,
    twin: bool,
    experiments: int,
    runnable: Runnable,
) -> AxisResult:
    by_mass = None if weighed is None else weighed_gain(robot, joint, sweeps, weighed)
    gain = _accepted(known) if by_mass is None else by_mass
    wrong = gain if gain is not None and is_wrong(gain) else None
    calibrated = gain is not None and is_decided(gain)
    own = in_periods(joint, corrected(sweeps, wrong) if wrong else sweeps)
    data = check(robot, [sweep for sweep in sweeps if sweep.spec.axis == joint])
    trusted = not untrustworthy(data, joint)
    found = _explained(robot, joint, own, known, calibrated=calibrated, trusted=trusted)
    selection, shown, verdict, modelled = found.selection, found.shown, found.verdict, found.modelled
    motion, hidden = selection.given.tracks, found.hidden
    ties = tie_sets(selection, modelled, found.applying) if verdict is Verdict.AMBIGUOUS else {}
    before = shown.before
    if wrong and GAIN not in known:  # the gap is that of the measured, uncorrected effort
        before = _of_measured_effort(robot, joint, sweeps, selection, modelled)
    unseen = [k for k, pose_index in enumerate(motion.pose_index) if pose_index == found.unseen]
    where = (
        *lines(motion, before, shown.after),
        *cells(motion, selection.given.groups, before, shown.after, noise(selection.given, shown.after)),
    )
    twin_rms, of_twin = beside_twin(selection.given, own, shown.point) if twin else (None, ())
    effects = [_named(one, selection) for one in shown.fitted]
    named = [effect for effect in effects if effect.name not in modelled]
    base = [effect for effect in effects if effect.name in modelled]
    if gain and calibrated and (wrong or GAIN in known):
        (base if GAIN in known else named).insert(0, _weighed(gain))
        if verdict in (Verdict.NONE, Verdict.UNTESTABLE) and GAIN not in known:
            verdict = Verdict.NAMED
    law = None
    if trusted and verdict is Verdict.UNKNOWN and found.play is None:
        law = proposed_law(selection.given, selection.rigid.terms)
    wanted, ended = None, "its data cannot be trusted"
    if trusted:
        rivals = tuple(sorted({*ties, *chain(*ties.values())}))
        wanted, ended = next_experiment(selection, verdict, rivals, hidden, own, runnable, experiments, law)
    if wanted is not None and weighed is not None:
        wanted = replace(wanted, reason=f"{wanted.reason} {HEAVIER if wanted.kind == TEST_MASS else OFF}")
    unit = "N" if motion.prismatic else "N m"
    loose = unrepeated(selection.given, shown.after)
    said = (loose.sentence(joint, unit),) if loose is not None and loose.is_physical else ()
    result = AxisResult(
        joint=joint,
        unit=unit,
        verdict=verdict,
        effects=tuple(named),
        known=tuple(base),
        part=tuple(_named(one, selection) for one in found.part),
        changes=_changes(known, base),
        alternatives=tuple((name, *sorted(rivals)) for name, rivals in ties.items()),
        rivals=_behind(selection),
        rolled_back=shown.rolled_back,
        cells=tuple(sorted(where, key=lambda cell: -cell.significance)),
        sentences=(*(one.sentence for one in (*data, *found.said)), *sentences(joint, where), *said, *of_twin),
        gap=gap(selection.given, before, shown.after, unseen, twin_rms),
        example=example(selection.given, before, shown.after),
        poses=tuple(tuple(pose) for pose in motion.poses.tolist()),
        fit=shown.fit,
        rigid_model=rigid_model(selection.given, shown.fit),
        started_from=source_of(robot),
        weighed=wrong is not None,
        unexplained=selection.unexplained,
        law=law,
        next_experiment=wanted,
        ended=ended,
        data=(*data, *found.said),
        unfinished=unfinished(joint, selection, by_mass),
        untestable=(*hidden, *(name for name in CATALOGUE if name not in known and not applies(selection.given, name))),
        biasing=_biasing(hidden),
    )
    return result if found.play is None else _with_play(result, found.play, selection)


def _with_play(found: AxisResult, play: Play, selection: Selection) -> AxisResult:
    """The result of an axis whose gap no column explains, with the play that was measured about standstill."""
    given = selection.given
    patch = CATALOGUE[PLAY].scenario({"play": play.width, "load_friction_share": 0.5}, given.tracks, given.model)
    parameters = {"play": Parameter(play.width, play.std, "rad")}
    effect = NamedEffect(PLAY, parameters, np.array([[play.std**2]]), patch, play.gain, play.gain - np.log(play.rows))
    is_known = PLAY in (one.name for one in found.known)
    return replace(
        found,
        verdict=Verdict.NONE if is_known and not found.effects else Verdict.NAMED,
        effects=found.effects if is_known else (*found.effects, effect),
        known=tuple(effect if one.name == PLAY else one for one in found.known),
        part=(),
        rolled_back=(),
        sentences=(play.sentence(found.joint, found.unit), *found.sentences),
        gap=play.gap,
        unexplained=(play.after / play.before) ** 2,
        next_experiment=None,
        ended="",
        unfinished=(),
    )


@dataclass(frozen=True)
class _Explained:
    """Explanation of the sweeps of an axis, the candidate effects, and the changes made to the robot file for it."""

    selection: Selection
    verdict: Verdict
    shown: HeldOutCheck
    part: tuple[Fitted, ...]
    modelled: tuple[str, ...]
    applying: tuple[str, ...]
    hidden: dict[str, UntestableEffect]
    unseen: int | None
    said: tuple[DataFinding, ...] = ()
    play: Play | None = None


def _explained(
    robot: Robot, joint: str, sweeps: Sequence[Sweep], known: Known, *, calibrated: bool, trusted: bool
) -> _Explained:
    """The explanation. If there is none, measure play, else search the residual for torque ripples that are not in the
    robot file.
    """
    found = _tried(robot, joint, sweeps, known, calibrated=calibrated, trusted=trusted)
    if found.verdict is not Verdict.UNKNOWN or not trusted:
        return found
    if (play := measured_play(robot, joint, sweeps)) is not None:
        return replace(found, play=play)
    left = residual(found.selection.given, found.selection.chosen.terms)
    other, said = with_ripples(robot, joint, ripples(found.selection.given, left))
    if other is robot or not _ripples_tell(found.selection, other):
        return found
    again = _tried(other, joint, sweeps, known, calibrated=calibrated, trusted=trusted, before=found.selection.given)
    return found if again.verdict is Verdict.UNKNOWN else replace(again, said=said)


def _ripples_tell(selection: Selection, other: Robot) -> bool:
    """Whether the ripples of another robot file explain half of the rest: a ripple has one phase in all sweeps."""
    given = replace(selection.given, tracks=replace(selection.given.tracks, robot=other))
    left = [
        CurrentModel(given, [term for term in selection.chosen.terms if term.effect != name]).best(name).cost
        for name in ("cogging_torque", "transmission_error")
        if applies(given, name)
    ]
    return min(left, default=np.inf) < 0.5 * selection.chosen.cost


def _selected(given: Equations, sweeps: Sequence[Sweep], known: Sequence[str], candidates: Sequence[str]) -> Selection:
    """The selection with the best reversal distance of dry friction. The distance that is best beside the effects found
    may be another one than that of Coulomb friction alone: then it is selected again.
    """
    dry = Term("coulomb_friction")

    def with_better(found: Selection) -> Equations | None:
        # presliding imitates dry friction that reverses within another distance
        terms = tuple(dry if term.effect == "presliding_hysteresis" else term for term in found.chosen.terms)
        beside = _sticking(replace(found.given, tracks=given.tracks), sweeps, terms)
        gain = CurrentModel(found.given, terms).alone().cost - CurrentModel(beside, terms).alone().cost
        return replace(given, tracks=beside.tracks) if gain > CHANGED**2 else None

    return select(_sticking(given, sweeps, (dry,)), known, candidates, with_better)


def _sticking(given: Equations, sweeps: Sequence[Sweep], terms: Sequence[Term]) -> Equations:
    """The equations with the best of several reversal distances of dry friction, all too short for presliding."""
    longer = 2.0  # factor between the reversal distances of dry friction that are tried
    ways = [given.tracks.sticking]
    while longer * ways[-1] <= given.tracks.turning:
        ways.append(longer * ways[-1])
    ways += [SHORTEST] if ways[0] > SHORTEST else []  # an encoder without noise may show immediate friction reversal
    best, least = given, np.inf
    for way in ways:
        tried = given if way == ways[0] else replace(given, tracks=sticking_within(given.tracks, sweeps, way))
        cost = CurrentModel(tried, terms).alone().cost
        if cost < least - CHANGED**2:
            best, least = tried, cost
    return best


def _tried(
    robot: Robot,
    joint: str,
    sweeps: Sequence[Sweep],
    known: Known,
    *,
    calibrated: bool,
    trusted: bool,
    before: Equations | None = None,
) -> _Explained:
    """`before`: equations of another attempt on these sweeps, whose searches, and that for the reversal distance of dry
    friction, need not be repeated.
    """
    motion = tracks(robot, joint, sweeps)
    groups = grouped(motion)
    unseen = held_back(motion, groups)
    seen = [group for group in groups if group.fold != unseen]
    given = equations(motion, seen)
    if not given.pairs.rows:
        raise BadInput(joint, "its sweeps have no sample off standstill and the first way from there: record longer")
    possible = [name for name in CATALOGUE if applies(given, name) and not (calibrated and name == GAIN)]
    modelled = [name for name in known if name in possible]
    applying = [name for name in possible if name not in modelled] if trusted else []
    if before is None:
        selection = _selected(given, sweeps, modelled, applying)
    else:
        at = sticking_within(motion, sweeps, before.tracks.sticking)
        selection = select(replace(given, tracks=at, ends_of_steps=before.ends_of_steps), modelled, applying)
    hidden = untestable(selection.given, [name for name in applying if name not in selection.chosen.names], sweeps)
    testable = [name for name in applying if name not in hidden]
    named = with_groups(selection, groups)
    selection = settled(named, modelled)
    verdict, shown, part = _shown(selection, modelled, testable, _biasing(hidden))
    if unseen is not None and verdict is not Verdict.UNKNOWN and not shown.rolled_back:
        # of the held-out pose: the prediction of a model that was not fitted to it
        after, held = residual(named.given, named.chosen.terms), motion.pose_index == unseen
        shown = replace(shown, after=np.where(held[:, None], after, shown.after))
    if not trusted:  # no effect is named from data that is not trustworthy
        verdict = Verdict.UNKNOWN
    return _Explained(selection, verdict, shown, part, tuple(modelled), tuple(applying), hidden, unseen)


def _biasing(hidden: Mapping[str, UntestableEffect]) -> tuple[str, ...]:
    return tuple(name for name, one in hidden.items() if one.biases)


def _shown(
    selection: Selection, known: Sequence[str], testable: Sequence[str], biasing: Sequence[str]
) -> tuple[Verdict, HeldOutCheck, tuple[Fitted, ...]]:
    """The verdict after the test on held-out sweeps, and the effects that explain only a part of the gap.

    An effect that the held-out sweeps do not confirm is removed. Unknown effects are never added to the model.
    """
    given = selection.given
    fixed = [term for term in selection.chosen.terms if term.effect in known]
    added = [term for term in selection.chosen.terms if term.effect not in known]
    shown = check_held_out(given, fixed, added)
    left = without(selection, shown.rolled_back) if shown.rolled_back else selection
    loose = unrepeated(given, shown.after)
    moved_otherwise = loose is not None and loose.is_physical and not of_one_record(given)
    quiet = at_floor(left, shown.after) and not moved_otherwise
    conclusive = noise_floor(given, shown.after, range(len(shown.after))) is not None and not biasing
    verdict = judge(left, known, testable, at_floor=quiet, conclusive=conclusive)
    if shown.rolled_back and len(left.chosen.terms) == len(fixed):
        verdict = Verdict.UNKNOWN
    if verdict is not Verdict.UNKNOWN:
        return verdict, shown, ()
    part = (
        tuple(one for one in shown.fitted if one.effect not in known) if allowed_by_physics(given, left.chosen) else ()
    )
    bare = check_held_out(given, fixed, []) if added else shown
    return verdict, replace(bare, rolled_back=shown.rolled_back), part


def _of_measured_effort(
    robot: Robot, joint: str, sweeps: Sequence[Sweep], selection: Selection, known: Sequence[str]
) -> Array:
    """Residual (n, rows) of the effort as measured by the drive, for the model without new effects."""
    own = in_periods(joint, sweeps)
    given = equations(tracks(robot, joint, own), selection.given.groups)
    fixed = [term for term in selection.chosen.terms if term.effect in known]
    return residual(given, fixed, as_cad=True)


def _named(one: Fitted, selection: Selection) -> NamedEffect:
    term = next(term for term in selection.chosen.terms if term.effect == one.effect)
    return NamedEffect(one.effect, one.parameters, one.covariance, one.patch, *share(selection, term))


def _changes(known: Known, now: Sequence[NamedEffect]) -> tuple[ParameterChange, ...]:
    """Parameters whose difference is significant with respect to both standard deviations."""
    return tuple(
        ParameterChange(effect.name, name, model, effect.parameters[name])
        for effect in now
        for name, model in known[effect.name].items()
        if name in effect.parameters
        and abs(effect.parameters[name].value - model.value)
        > CHANGED * np.hypot(effect.parameters[name].std, model.std)
    )


def _behind(selection: Selection) -> tuple[tuple[str, float], ...]:
    """The other explanations, each with the effect in which it differs; the best first."""
    behind: dict[str, float] = {}
    for tried in sorted(selection.tried, key=lambda one: one.criterion):
        behind.setdefault(tried.terms[-1].effect, tried.criterion - selection.chosen.criterion)
    return tuple(behind.items())


def _accepted(known: Known) -> TorqueGain | None:
    """The torque gain in the model. Sweeps cannot separate it from a load, so it stays until the next test mass."""
    error = known.get(GAIN, {}).get(GAIN_ERROR)
    return None if error is None else TorqueGain(1 + error.value, error.std)


def _weighed(gain: TorqueGain) -> NamedEffect:
    """The error of the torque constant as measured with the test mass."""
    squares, error = ((gain.gain - 1) / gain.std) ** 2, gain.gain - 1
    parameters = {GAIN_ERROR: Parameter(error, gain.std, "")}
    patch: Patch = {"train": {"effort_gain": error}}
    return NamedEffect(GAIN, parameters, np.array([[gain.std**2]]), patch, squares, squares)


def source_of(robot: Robot) -> str:
    """Source of the initial rigid model of a robot: `CAD`, or which estimate."""
    return CAD if robot.knowledge is None else robot.knowledge.source
