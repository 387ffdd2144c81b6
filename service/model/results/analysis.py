"""The initial analysis of an axis: "analysis" of an estimate, by joint."""

import math
from collections.abc import Mapping

from service.model.results.effect import Value
from service.model.results.part import Document, Part
from service.model.results.table import Column, Table


class Figure(Part):
    """A number with one standard deviation; null is infinite."""

    value: float | None
    std: float | None


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


class AnalysedPose(Part):
    """One pose, evaluated by the fit and by asymptotes."""

    pose: tuple[float, ...]
    load_inertia: float
    fit: Ideal
    asymptotes: Ideal
    frequency_response: tuple[AnalysedLine, ...]

    @property
    def at_least(self) -> tuple[float, float] | None:
        """Lower bounds of the locked-rotor and of the ideal frequency, Hz, if the fitted one is above the last line."""
        last, locked, corner = self.frequency_response[-1].frequency, self.fit.locked_rotor, self.fit.corner
        if locked.value is not None and locked.value <= last:
            return None
        return last, math.sqrt(last * (math.inf if corner.value is None else corner.value))


class PoseClass(Part):
    """Similar poses: upper limit of inertia, kg m^2 (kg, null: none), locked rotor and lowest line of a sweep, Hz."""

    name: str
    inertia_up_to: float | None
    locked_rotor: float | None
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
    if pose.at_least is not None:  # the asymptotes then end at a resonance that is none
        locked_rotor, ideal = (f"above {bound:.4g}" for bound in pose.at_least)
    return _with_std(fit.inertia), locked_rotor, _both(fit.corner, read.corner), ideal, f"{fit.sweep_frequency:g}"


def _both(fit: Figure, read: Figure) -> str:
    return f"{_with_std(fit)} ({_text(read.value)})"


def _with_std(figure: Figure) -> str:
    return f"{_text(figure.value)} ± {_text(figure.std)}"


def _text(value: float | None) -> str:
    return f"{math.inf if value is None else value:.4g}"


Analyses = Mapping[str, AxisAnalysis]  # by joint
