"""An estimate: `sweepid identify --json`, and each revision of a campaign."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field

from service.model.results.combination import Bounded, Combination, Physical, StandardParameters
from service.model.results.effect import ModelSource, Value
from service.model.results.part import Column, Document, Part, Shown, Table, Unbounded, two_digits

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class Figure(Part):
    """A number with one standard deviation; null is infinite."""

    value: Unbounded
    std: Unbounded


class AnalysedLine(Part):
    """Effort over velocity at a frequency, Hz: N m s/rad (N s/m), `std` of its parts, and the coherence."""

    frequency: float
    re: float
    im: float
    std: float
    coherence: float


class Ideal(Part):
    """Inertia, kg m^2 (kg), friction, N m s/rad (N s/m), and the frequencies between which inertia dominates, Hz."""

    inertia: Figure
    friction: Figure
    locked_rotor: Figure
    corner: Figure
    frequency: Figure
    sweep_frequency: float

    def at_least(self, last: float) -> tuple[float, float] | None:
        """Lower bounds of the locked-rotor and of the ideal frequency, Hz, if the locked rotor is above the last line;
        else None.
        """
        return None if self.locked_rotor.value <= last else (last, math.sqrt(last * self.corner.value))


class AnalysedPose(Part):
    """One pose, evaluated by the fit and by asymptotes."""

    pose: tuple[float, ...]
    load_inertia: float
    fit: Ideal
    asymptotes: Ideal
    frequency_response: tuple[AnalysedLine, ...]


class PoseClass(Part):
    """Similar poses: upper limit of inertia, kg m^2 (kg, null: none), locked rotor and lowest line of a sweep, Hz."""

    name: str
    inertia_up_to: Unbounded
    locked_rotor: Unbounded
    sweep_frequency: float


class AxisAnalysis(Document):
    """The drive train with its covariance, classes of poses, and the poses that were measured."""

    drive_train: dict[str, Value]
    covariance: tuple[tuple[float, ...], ...]
    chi_squared: float
    classes: tuple[PoseClass, ...] = ()
    poses: tuple[AnalysedPose, ...]


def analysis_table(analyses: "Analyses") -> Table:
    """Pose by pose: where the load swings, where friction rules, and which frequency lies between them."""
    rows = [
        (joint, ", ".join(f"{position:.2f}" for position in pose.pose), *_pose(pose))
        for joint, axis in analyses.items()
        for pose in axis.poses
    ]
    names = ("axis", "pose in rad", "J", "locked rotor, Hz", "friction below, Hz", "ideal, Hz", "sweep, Hz")
    columns = zip(names, zip(*rows, strict=True), strict=True)
    return Table("Initial analysis; in brackets by asymptotes", tuple(Column(name, values) for name, values in columns))


def _pose(pose: AnalysedPose) -> tuple[str, ...]:
    fit, read = pose.fit, pose.asymptotes
    locked_rotor, ideal = _both(fit.locked_rotor, read.locked_rotor), _both(fit.frequency, read.frequency)
    at_least = fit.at_least(pose.frequency_response[-1].frequency)
    if at_least is not None:  # the asymptotes then end at a resonance that is none
        locked_rotor, ideal = (f"above {bound:.4g}" for bound in at_least)
    return _with_std(fit.inertia), locked_rotor, _both(fit.corner, read.corner), ideal, f"{fit.sweep_frequency:g}"


def _both(fit: Figure, read: Figure) -> str:
    return f"{_with_std(fit)} ({read.value:.4g})"


def _with_std(figure: Figure) -> str:
    return f"{figure.value:.4g} ± {figure.std:.4g}"


Analyses = Mapping[str, AxisAnalysis]  # by joint


class ResponseLine(Part):
    """Effort over velocity at a frequency, Hz: N m s/rad (N s/m), `std` of its parts."""

    frequency: float
    re: float
    im: float
    std: float
    noise_std: float | None = None
    distortion_std: float | None = None


class SweepInertia(Part):
    """Inertia from one sweep, kg m^2 (kg): measured, nominal and identified model, formula of the paper."""

    sweep: str
    value: Bounded
    std: float
    std_total: float | None = None
    reference: Bounded
    identified: Bounded
    paper_value: float | None
    viscous_friction: float | None = None
    frequency_response: tuple[ResponseLine, ...] = ()
    terms: dict[str, Value] = Field(default={})
    warning: str = ""


class Rmse(Part):
    """The paper's Table 1, percent."""

    reference_measured: float
    identified_measured: float
    reference_identified: float


class HeldOut(Part):
    """Prediction errors for poses that were not used."""

    sweeps: int
    rmse_percent: float
    standardized_rmse: float
    within_95_percent: float


class CramerRao(Part):
    """Medians over the sweeps: the bound, and the efficiency reached."""

    bound_percent: float
    std_over_bound: float


class DistortedLine(Part):
    """Amplitudes at a frequency, Hz: N m (N)."""

    frequency: float
    noise_std: float
    distortion_std: float


class Distortion(Part):
    """Noise and nonlinear distortion of the effort, N m (N), over realisations of the sweeps."""

    realisations: int
    poses: int
    effort: tuple[DistortedLine, ...]


class Spread(Part):
    """Standard deviation of the inertia over the workspace, percent."""

    median: float
    worst: float


class TorqueGain(Part):
    """Indicated effort of the drive over true effort."""

    value: float
    std: float


class EstimatedAxis(Shown, Part):
    """The identified values of one axis; null: not determined by its sweeps."""

    inertia: tuple[SweepInertia, ...]
    rmse_percent: Rmse
    drive_train: dict[str, Value] | None = None
    load_motion: str = "motor_encoder"
    torque_gain: TorqueGain = TorqueGain(value=1.0, std=0.0)
    distortion: Distortion | None = None
    effects_moved_in_std: float | None = None
    confidence_percent: float | None = None
    workspace_std_percent: Spread | None = None
    reduced_chi_squared: float | None = None
    held_out: HeldOut | None = None
    cramer_rao: CramerRao | None = None

    def table(self) -> Table:
        """Total inertia about the axis in the pose of each sweep."""
        sweeps = self.inertia
        std = tuple(one.std for one in sweeps)
        return Table(
            "Inertia about the axis, kg m^2 (kg)",
            (
                Column("sweep", tuple(one.sweep for one in sweeps)),
                Column("measured", tuple(one.value for one in sweeps), std=std),
                Column("std", std, std=std),
                Column("std_total", tuple(one.std_total for one in sweeps), ".2g"),
                Column("reference", tuple(one.reference for one in sweeps), std=std),
                Column("identified", tuple(one.identified for one in sweeps), std=std),
            ),
        )


class BaseParameter(Part):
    """A combination of inertial parameters, kg, kg m or kg m^2; std null: not identified, for the given `reason`.

    `reference`: that of the nominal model, null in documents that do not state it.
    """

    name: str
    symbolic: str | None = None
    value: Bounded
    std: float | None
    reference: float | None = None
    reason: str = ""


class Base(Part):
    """Joints that never moved, with their positions, rad (m), and the covariance of the base parameters."""

    locked: dict[str, float] = Field(default={})
    covariance: tuple[tuple[float, ...], ...] = ()


class Symbol(Part):
    """A distance or an angle that occurs in the names of base parameters."""

    value: float
    unit: str
    meaning: str


class Suspect(Part):
    """A sweep inconsistent with the others, and its reduced weight."""

    axis: str
    sweep: str
    why: str
    weight: float


class TypeMember(Part):
    """An earlier robot of the type, and the probability that it is as far from the others by chance."""

    name: str
    probability: float
    belongs: bool


class TypePrior(Part):
    """What earlier robots of the type told; `probability`: that this one differs as much from them by chance. Not used
    below 1 %.
    """

    members: tuple[TypeMember, ...]
    probability: float
    used: bool

    def told(self) -> list[str]:
        """Sentences on which robots were used, and which are no robots of the type."""
        strangers = [one for one in self.members if not one.belongs]
        chance = f"probability of such a difference by chance {self.probability:.2g}"
        told = "Prior:" if self.used else "Not used as a prior, because this robot differs from them:"
        other = "is no robot of this type: probability of its difference by chance"
        return [
            f"{told} {len(self.members) - len(strangers)} earlier robots of the type; {chance}.",
            *(f"{one.name} {other} {one.probability:.2g}." for one in strangers),
        ]


class UsedEffect(Part):
    """A known effect, and whether and how it was used in the estimate."""

    axis: str
    effect: str
    parameters: dict[str, Value]
    used: bool
    how: str


class Estimate(Shown, Document):
    """Axes by joint, base parameters, the initial analysis and the combination with trajectories.

    `model`: the model that contains the effects, null if there are none. `prior`: earlier robots of the type, null if
    none were named. `updates`: sweeps that were added to the last fit of all sweeps; a campaign ends with such a fit.
    """

    axes: dict[str, EstimatedAxis]
    base_parameters: tuple[BaseParameter, ...]
    base: Base = Base()
    symbols: dict[str, Symbol] = Field(default={})
    condition_number: float | None
    standard_parameters: StandardParameters
    physical: Physical = Physical(deviation_in_std=None)
    suspect: tuple[Suspect, ...] = ()
    effects: tuple[UsedEffect, ...] = ()
    model: ModelSource | None = None
    analysis: dict[str, AxisAnalysis] = Field(default={})
    combination: Combination | None = None
    prior: TypePrior | None = None
    updates: int = 0

    def table(self) -> Table:
        """The base parameters."""
        std = tuple(one.std for one in self.base_parameters)
        return Table(
            "Base parameters, SI, about the joints' axes",
            (
                Column("parameter", tuple(one.symbolic or one.name for one in self.base_parameters)),
                Column("CAD", tuple(one.reference for one in self.base_parameters), std=std),
                Column("value", tuple(one.value for one in self.base_parameters), std=std),
                Column("std", std, std=std),
            ),
        )

    def plot(self) -> "Sequence[Axes]":
        """Draws the inertias of each axis; where only motions were measured, what determines the parameters."""
        from service.model.results import plots  # matplotlib

        if not self.axes and self.combination is not None:
            return (plots.sources(self.combination.table()),)
        return plots.inertias({joint: axis.table() for joint, axis in self.axes.items()})

    def shown(self) -> Sequence[Table | str]:
        """Initial analysis, Table 1 of the paper for this robot, base parameters, and what to know of them."""
        parts: list[Table | str] = [analysis_table(self.analysis)] if self.analysis else []
        if self.combination is not None:
            parts += self.combination.shown()
        if not self.axes:
            return parts
        parts += [self._rmse_table(), f"Confidence of J ({CONFIDENCE}): {self._confidence()}", self.table()]
        for one in self.base_parameters:
            if one.reason:
                parts.append(f"Not identified: {one.symbolic or one.name}: {one.reason}")
        parts += [f"  {name} = {of.value:.5g} {of.unit}, {of.meaning}" for name, of in self.symbols.items()]
        if any(sweep.terms for axis in self.axes.values() for sweep in axis.inertia):
            parts.append(self._terms_table())
        parts += [f"Suspect: sweep {one.sweep} of {one.axis}, {one.why}" for one in self.suspect]
        for one in self.effects:
            parts.append(f"{'Taken into account' if one.used else 'Left out'}: {one.effect} of {one.axis}, {one.how}")
        if self.prior is not None:
            parts += self.prior.told()
        condition = "undetermined" if self.condition_number is None else f"{self.condition_number:.3g}"
        return [*parts, f"Condition number of the observation matrix: {condition}"]

    def _rmse_table(self) -> Table:
        rows = ("reference - measurement", "identified - measurement", "reference - identified (workspace)", "sweeps")
        columns: list[Column] = []
        for joint, axis in self.axes.items():
            of = axis.rmse_percent
            sizes = (of.reference_measured, of.identified_measured, of.reference_identified, len(axis.inertia))
            columns.append(Column(joint, sizes, ".2f"))
        return Table("RMSE of the axis inertias in percent", (Column("", rows), *columns))

    def _confidence(self) -> str:
        stated = {joint: axis.confidence_percent for joint, axis in self.axes.items()}
        return ", ".join(f"{joint} {'–' if one is None else f'{two_digits(one)} %'}" for joint, one in stated.items())

    def _terms_table(self) -> Table:
        """What else was found in records without lines, which are fitted one by one."""
        rows = [
            (joint, sweep.sweep, name, term.value, term.std)
            for joint, axis in self.axes.items()
            for sweep in axis.inertia
            if sweep.terms
            for name, term in {"inertia": Value(value=sweep.value, std=sweep.std), **sweep.terms}.items()
        ]
        axes, sweeps, terms, values, std = zip(*rows, strict=True)
        texts = Column("axis", axes), Column("sweep", sweeps), Column("term", terms)
        return Table(
            "Records without lines, SI", (*texts, Column("value", values, std=std), Column("std", std, std=std))
        )


CONFIDENCE = "one standard deviation in the worst pose, with a correct torque constant"
UNSURE = 0.25  # of the value: a value with a larger standard deviation should not be used


@dataclass(frozen=True, slots=True)
class AxisFigures:
    """An axis as sheet, report and page tell it: medians over the poses of its sweeps, kg m^2 (kg).

    `std` includes the uncertainty of the torque constant. `percent`: difference from CAD in percent of the identified,
    NaN where one of them is not above 0.
    """

    identified: float
    std: float
    cad: float
    lowest: float
    highest: float
    percent: float


def axis_figures(axis: EstimatedAxis) -> AxisFigures:
    """`axis` has at least one sweep."""
    identified = [sweep.identified for sweep in axis.inertia]
    value, cad = float(np.median(identified)), float(np.median([sweep.reference for sweep in axis.inertia]))
    percent = 100 * (1 - cad / value) if cad > 0 and value > 0 else math.nan
    return AxisFigures(value, share_of_value(axis) * abs(value), cad, min(identified), max(identified), percent)


def share_of_value(axis: EstimatedAxis) -> float:
    """`share_of_sweeps`, and the uncertainty of the torque constant."""
    return math.hypot(share_of_sweeps(axis), share_of_gain(axis))


def share_of_sweeps(axis: EstimatedAxis) -> float:
    """The confidence, relative to J; while the estimate states none, the median of the sweeps. inf for a J of 0."""
    if axis.confidence_percent is not None:
        return axis.confidence_percent / 100
    return float(np.median([_share(sweep.std, sweep.value) for sweep in axis.inertia]))


def share_of_gain(axis: EstimatedAxis) -> float:
    """Standard deviation of the torque constant relative to its value: it scales J, and no sweep shows it."""
    return _share(axis.torque_gain.std, axis.torque_gain.value)


def _share(std: float, value: float) -> float:
    return std / abs(value) if value else math.inf


def not_for_use(parameter: BaseParameter) -> str:
    """Why the value of a base parameter should not be used, or ""."""
    if parameter.std is None:
        return "not identified"
    return "too uncertain" if parameter.std > UNSURE * abs(parameter.value) else ""
