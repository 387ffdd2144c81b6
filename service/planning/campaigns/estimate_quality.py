"""The quality of a stored estimate, in a few values."""

from dataclasses import dataclass

from service.model.results.estimate import EstimatedAxis
from service.store.documents import EstimateDocument


@dataclass(frozen=True, slots=True)
class AxisQuality:
    """Quality of one axis; relative values, without unit."""

    sweeps: int
    gap: float  # RMS difference of the measured inertia from that of the robot file
    left: float  # RMS difference of the measured from the identified inertia
    std: float | None  # median uncertainty over the workspace, 1 s; None if the sweeps do not determine it


@dataclass(frozen=True, slots=True)
class Quality:
    """Quality of one estimate."""

    revision: int
    made: float  # s, Unix time
    condition: float | None
    suspect: int  # sweeps that are inconsistent with the others
    axes: dict[str, AxisQuality]


def quality_of(estimate: EstimateDocument) -> Quality:
    """BadInput if the document is not an estimate."""
    found = estimate.content
    return Quality(
        revision=estimate.revision,
        made=estimate.created_at.timestamp(),
        condition=found.condition_number,
        suspect=len(found.suspect),
        axes={joint: _of_axis(axis) for joint, axis in found.axes.items()},
    )


def _of_axis(axis: EstimatedAxis) -> AxisQuality:
    return AxisQuality(
        sweeps=len(axis.inertia),
        gap=axis.rmse_percent.reference_measured / 100,
        left=axis.rmse_percent.identified_measured / 100,
        std=None if axis.workspace_std_percent is None else axis.workspace_std_percent.median / 100,
    )
