"""A diagnosis: the difference between model and measurement by axis, and the resulting model."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from pydantic import Field, JsonValue

from service.model.recording import SweepSpec
from service.model.results.effect import AxisFit, Effect, Value
from service.model.results.part import Column, Document, Part, Shown, Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, slots=True)
class Bin:
    """From `low` to `high` (None: a single value), in `unit`; `parts`: divisions of the unit, which `low` counts."""

    low: float
    high: float | None
    unit: str
    parts: int | None = None


class Cell(Part):
    """RMS of the repeatable gap in a bin, N m (N), before and after, and its significance in standard deviations."""

    dimension: str
    value: str
    rms: float
    significance: float
    rms_after: float

    @property
    def bin(self) -> Bin | None:
        """`value` in numbers: "0.1 to 0.2 rad/s", "3 Hz", "0/8 turn"; None for the name of a block or a direction."""
        first, *rest = self.value.split(" ")
        number, _, parts = first.partition("/")
        low, high = _number(number), None
        if rest[:1] == ["to"] and len(rest) > 1:
            high, rest = _number(rest[1]), rest[2:]
            if high is None:
                return None
        if low is None or not rest or (parts and not parts.isdecimal()):
            return None
        return Bin(low, high, " ".join(rest), int(parts) if parts else None)


def _number(text: str) -> float | None:
    """A number written with digits; not "nan" or "1_000", which are not used for bins."""
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) and "_" not in text else None


class Finding(Part):
    """`severity` wrong: the physics of the `axis` (null: of the whole robot) cannot be trusted; warning: read it.

    `value` and `limit` have the unit given in the sentence; null if there is no number.
    """

    code: str
    severity: Literal["wrong", "warning"]
    axis: str | None
    sweeps: tuple[str, ...]
    value: float | None
    limit: float | None
    sentence: str
    action: str


class CheckedAxis(Part):
    """A swept axis, and the codes of its findings."""

    sweeps: int
    trustworthy: bool
    codes: tuple[str, ...]


class DataCheck(Shown, Document):
    """Do recordings, set-points and robot file fit together?"""

    findings: tuple[Finding, ...]
    axes: dict[str, CheckedAxis]

    @property
    def _what(self) -> str:
        count = sum(axis.sweeps for axis in self.axes.values())
        return f"{count} sweep{'s' * (count > 1)}"

    def table(self) -> Table:
        """One row a finding: what was found and what to do."""
        return Table(
            f"Check of {self._what}",
            (
                Column("", tuple(one.severity for one in self.findings)),
                Column("what", tuple(one.code for one in self.findings)),
                Column("found", tuple(one.sentence for one in self.findings)),
                Column("to do", tuple(one.action for one in self.findings)),
            ),
        )

    def shown(self) -> Sequence[Table | str]:
        """The findings, or that there is none."""
        return (self.table(),) if self.findings else (f"Nothing found in {self._what}.",)


TEST_MASS = "test_mass"  # the kind whose sweeps are run with a known mass on the last link


class ExperimentSweep(Part):
    """A designed sweep; `ramp` and `settle`, s."""

    spec: SweepSpec
    ramp: float
    settle: float


class Experiment(Part):
    """What to measure next, and the reason; `seconds` of machine time.

    `kind`: a block, `full_design`, `more_poses`, `warm_up` or `test_mass`. `separation`: expected chi-squared of the
    difference of the effects `between`, null if it was not computed.
    """

    kind: str
    blocks: tuple[str, ...]
    sweeps: tuple[ExperimentSweep, ...]
    seconds: float
    separation: float | None
    between: tuple[str, ...]
    reason: str

    @property
    def weighs(self) -> bool:
        """True if a known mass must be mounted."""
        return self.kind == TEST_MASS


Verdict = Literal["none", "named", "ambiguous", "unknown", "untestable"]
Standing = Literal["settled", "open", "unexplained"]


class Change(Part):
    """A parameter of a known effect: the value in the model, and the present value."""

    effect: str
    parameter: str
    model: Value
    now: Value


class Rival(Part):
    """Another candidate instead of the chosen explanation; `behind`: its difference in Schwarz's criterion."""

    effect: str
    behind: float


class PoseGap(Part):
    """RMS of the residual in one pose, N m (N); the noise floor is null if nothing was repeated."""

    pose: tuple[float, ...]
    before_rms: float
    after_rms: float
    noise_floor_rms: float | None
    sweeps: int


class Gap(Part):
    """RMS of the residual, N m (N), and in percent of the effort.

    `held_out_sweeps`: those not used to select or fit effects. `cross_validated`: each pose (or repeat) was tested with
    a fit to the others; older documents without the key were cross-validated whenever possible. `twin_rms`: residual of
    the simulator with the identified model.
    """

    before_rms: float
    after_rms: float
    noise_floor_rms: float | None
    held_out_sweeps: int
    cross_validated: bool = False
    source: str = "columns"
    before_percent: float
    after_percent: float
    twin_rms: float | None = None
    by_pose: tuple[PoseGap, ...]


class Example(Part):
    """The sweep with the largest gap: time, s; measured effort, and that of both models, N m (N)."""

    sweep: str
    block: str
    time: tuple[float, ...]
    measured: tuple[float, ...]
    before: tuple[float, ...]
    after: tuple[float, ...]


class Unfinished(Part):
    """A search that used up its steps: a warning. `effect`: whose search it was; null: that of the load and all shapes
    in turn.
    """

    effect: str | None
    sentence: str
    action: str


class RigidParameter(Part):
    """A base parameter of the rigid model: value of CAD or an estimate (null: none), and identified value."""

    name: str
    nominal: float | None
    value: float
    std: float | None


class ProposedLaw(Part):
    """A law proposed for an unknown gap; it enters no model. The parts and RMS, N m (N), are those of held-out sweeps,
    which took no part in its selection or fit: gap without and with it, and the part of the gap that it closes.
    """

    sentence: str
    formula: str
    parameters: dict[str, Value]
    before_rms: float
    after_rms: float
    closed: float
    held_out_sweeps: int


class AxisDiagnosis(Document):
    """The result for one axis; `unit` is that of its effort.

    `effects`: named (or, if undecided, the simplest explanation so far). `known`: in the model. `part`: those that
    explain a part; the rest is unknown. `law`: proposed for an unknown gap, only if there is one. `where`: the map of
    the gap. `data`: findings of the data check. `unfinished`: searches that used up their steps, only if there are any.
    `biasing`: the `untestable` effects that would change the estimate by more than its standard deviation. `standing`:
    see `standing_of`. Both are missing in older documents.
    """

    verdict: Verdict
    unit: str
    effects: tuple[Effect, ...]
    known: tuple[Effect, ...]
    part: tuple[Effect, ...] = ()
    changes: tuple[Change, ...] = ()
    candidates: tuple[str, ...]
    alternatives: tuple[tuple[str, ...], ...] = ()
    rivals: tuple[Rival, ...]
    rolled_back: tuple[str, ...]
    where: tuple[Cell, ...]
    sentences: tuple[str, ...]
    gap: Gap
    example: Example
    fit: AxisFit
    started_from: str = "cad"
    rigid_model: tuple[RigidParameter, ...] = ()
    unexplained: float | None = None
    law: ProposedLaw | None = None
    next_experiment: Experiment | None
    untestable: tuple[str, ...]
    biasing: tuple[str, ...] = ()
    standing: Standing | None = None
    data: tuple[Finding, ...] = ()
    unfinished: tuple[Unfinished, ...] = ()
    visible_in: dict[str, tuple[str, ...]] = Field(default={})
    summary: str

    @property
    def has_noise_floor(self) -> bool:
        """Whether sweeps were repeated: without, nothing shows that the residual is noise."""
        return self.gap.noise_floor_rms is not None or any(p.noise_floor_rms is not None for p in self.gap.by_pose)

    @property
    def explained(self) -> bool:
        """Whether there are residuals "after": effects that were not in the model."""
        return bool(self.effects)


def standing_of(axis: AxisDiagnosis) -> Standing:
    """What the verdict of an axis is worth: the only source of a colour and of *Confirmed*.

    `settled`: a gap that is none or named, judged by a noise floor, and no effect of weight is untestable.
    `unexplained`: a gap that no effect explains. Everything else is `open`, also `none` in an older document.
    """
    if axis.verdict == "unknown":
        return "unexplained"
    shown = axis.verdict in ("none", "named") and axis.has_noise_floor and not axis.biasing
    return "settled" if shown else "open"


class DiagnosedModel(Part):
    """The model of the axes: effects by joint, the scenario of a virtual machine, and the parts it cannot contain."""

    robot: str
    effects: dict[str, tuple[Effect, ...]]
    scenario: dict[str, JsonValue] = Field(default={})
    notes: tuple[str, ...] = ()


class Diagnosis(Shown, Document):
    """All axes by joint, and the model with the named effects: `sweepid diagnose --json`."""

    axes: dict[str, AxisDiagnosis]
    model: DiagnosedModel

    def table(self) -> Table:
        """Verdict and gap of each axis. "twin" is what the simulator leaves with the model that is handed on."""
        axes = self.axes.values()
        return Table(
            "Diagnosis; gap, RMS",
            (
                Column("axis", tuple(self.axes), whole=True),
                Column("verdict", tuple(axis.verdict for axis in axes)),
                Column("effects", tuple(_named(axis) for axis in axes), whole=True),
                Column("before", tuple(axis.gap.before_rms for axis in axes), ".4g"),
                Column("after", tuple(axis.gap.after_rms for axis in axes), ".4g"),
                Column("noise floor", tuple(axis.gap.noise_floor_rms for axis in axes), ".4g"),
                Column("twin", tuple(axis.gap.twin_rms for axis in axes), ".4g"),
                Column("", tuple(axis.unit for axis in axes)),
            ),
        )

    def plot(self) -> "Axes":
        """Draws the gap of each axis before and after the named effects, and its noise floor."""
        from service.model.results import plots  # matplotlib

        return plots.gaps(self.table())

    def shown(self) -> Sequence[Table | str]:
        """Also the same in words, where the gap is, the parameters, and what to measure next."""
        return [self.table(), *(part for joint, axis in self.axes.items() for part in _axis_shown(joint, axis))]


def _named(axis: AxisDiagnosis) -> str:
    names = axis.candidates or [effect.effect for effect in axis.effects]
    return (" or " if axis.candidates else ", ").join(names) or "-"


def _axis_shown(joint: str, axis: AxisDiagnosis) -> Sequence[Table | str]:
    from_cad = axis.started_from == "cad"
    parts: list[Table | str] = [axis.summary]
    if not from_cad:
        parts.append(f"  The rigid model started from {axis.started_from}.")
    parts += [f"  {sentence}" for sentence in axis.sentences]
    parts += [f"  Warning: {search.sentence} {search.action}" for search in axis.unfinished]
    for effect in axis.effects:
        parts += _effect_lines(effect, "If it is that: " if effect.effect in axis.candidates else "")
    for effect in axis.part:
        parts += _effect_lines(effect, "Part of it, in addition to an unknown effect: ")
    if axis.law is not None:
        parts += [*_effect_lines(axis.law, ""), f"    {axis.law.formula}"]
    std = tuple(one.std for one in axis.rigid_model)
    columns = (
        Column("parameter", tuple(one.name for one in axis.rigid_model)),
        Column("CAD" if from_cad else "estimate", tuple(one.nominal for one in axis.rigid_model), std=std),
        Column("found", tuple(one.value for one in axis.rigid_model), std=std),
        Column("± std", std, std=std),
    )
    parts.append(Table(f"{joint}: rigid model, base parameters", columns))
    if axis.next_experiment is not None:
        parts.append(f"{joint}: next, {axis.next_experiment.kind}. {axis.next_experiment.reason}")
    return parts


def _effect_lines(effect: Effect | ProposedLaw, before: str) -> list[str]:
    """A parameter of which the sweeps tell nothing is not shown."""
    shown = [f"    {name} = {value.words}" for name, value in effect.parameters.items() if value.significant]
    open_ = ", ".join(name for name, value in effect.parameters.items() if not value.significant)
    return [f"  {before}{effect.sentence}", *shown, *([f"    not significant: {open_}"] if open_ else [])]
