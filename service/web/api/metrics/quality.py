"""Metrics of the latest estimate of each robot: its quality and its age."""

from collections.abc import Iterator, Mapping

from prometheus_client.core import Metric

from service.planning.campaigns.stored_results import Quality
from service.web.api.metrics.figure import Figure, figures_of

_ROBOT, _AXIS = ("robot",), ("robot", "axis")

REVISION = Figure("sweepid_estimate_revision", "of the robot's latest estimate", _ROBOT)
MADE = Figure("sweepid_estimate_time_seconds", "when it was made, Unix time; time() less this is its age", _ROBOT)
CONDITION = Figure("sweepid_estimate_condition_number", "of its linear system", _ROBOT)
SUSPECT = Figure("sweepid_estimate_suspect_sweeps", "sweeps that do not fit the others", _ROBOT)
SWEEPS = Figure("sweepid_estimate_sweeps", "sweeps of the axis in it", _AXIS)
GAP = Figure(
    "sweepid_estimate_gap_ratio", "RMS difference of measured inertia and that of the robot file, relative", _AXIS
)
LEFT = Figure(
    "sweepid_estimate_left_ratio", "RMS difference of measured inertia and that of the estimate, relative", _AXIS
)
STD = Figure("sweepid_estimate_std_ratio", "median relative uncertainty of the inertia over the workspace, 1 s", _AXIS)

FIGURES = figures_of(globals())


def quality(latest: Mapping[str, Quality]) -> Iterator[Metric]:
    """The metrics of all robots that have an estimate."""
    robots = {(name,): one for name, one in latest.items()}
    yield REVISION.by({robot: one.revision for robot, one in robots.items()})
    yield MADE.by({robot: one.made for robot, one in robots.items()})
    yield CONDITION.by({robot: one.condition for robot, one in robots.items() if one.condition is not None})
    yield SUSPECT.by({robot: one.suspect for robot, one in robots.items()})
    axes = {(name, joint): axis for name, one in latest.items() for joint, axis in one.axes.items()}
    yield SWEEPS.by({axis: one.sweeps for axis, one in axes.items()})
    yield GAP.by({axis: one.gap for axis, one in axes.items()})
    yield LEFT.by({axis: one.left for axis, one in axes.items()})
    yield STD.by({axis: one.std for axis, one in axes.items() if one.std is not None})
