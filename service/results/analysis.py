"""The initial analysis of an axis: "analysis" of an estimate, by joint."""

from collections.abc import Mapping

from service.results.effect import Value
from service.results.part import Document, Part


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


Analyses = Mapping[str, AxisAnalysis]  # by joint
