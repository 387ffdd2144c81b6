"""Measurements of the axes of a robot by campaign, made comparable: the same poses, one torque gain."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from service.identification.fleet.history import History, Measurement

Pose = tuple[int, ...]

_RESOLUTION = 0.01  # rad (m): poses with smaller differences are equal
_SHARED = 0.5  # of the newest campaign's poses that an older one must also have measured


@dataclass(frozen=True, slots=True)
class InPose:
    """J of an axis in one pose: its logarithm, that over J of the robot file, and the relative standard deviation.

    `std` is conditional on the torque gain.
    """

    log_value: float
    log_ratio: float
    std: float


@dataclass(frozen=True, slots=True)
class AxisMeasured:
    """An axis in one campaign. `calibration`: the torque gain that was used, `gain_std` its standard deviation."""

    poses: Mapping[Pose, InPose]
    calibration: float
    gain_std: float


@dataclass(frozen=True, slots=True)
class CampaignMeasured:
    """The axes of a robot in one campaign."""

    id: int
    at: datetime
    axes: Mapping[str, AxisMeasured]


def pose_key(pose: Sequence[float]) -> Pose:
    """Equal for poses that differ by less than the resolution of a planned pose."""
    return tuple(round(position / _RESOLUTION) for position in pose)


def in_pose(values: Sequence[float], references: Sequence[float], stds: Sequence[float]) -> InPose:
    """From the sweeps in one pose: values, those of the robot file, standard deviations, kg m^2 (kg), all above 0."""
    value, reference, std = (np.asarray(each, dtype=np.float64) for each in (values, references, stds))
    log = np.log(value)
    return InPose(
        log_value=float(log.mean()),
        log_ratio=float((log - np.log(reference)).mean()),
        std=float(np.sqrt(np.sum((std / value) ** 2)) / len(value)),
    )


def series(robot: str, axis: str, campaigns: Sequence[CampaignMeasured]) -> tuple[History, int]:
    """The newest comparable campaigns (input: the oldest first), and the number of older ones that are not comparable.

    The compared value is the mean of log J over the poses that all of them have, with equal weights: other weights or
    poses would look like a change of J if the robot file is wrong. The series ends at a campaign that would leave
    fewer than half of the poses of the newest one, or that has another torque gain.
    """
    of_axis = [(one, one.axes[axis]) for one in campaigns if axis in one.axes]
    if not of_axis:
        return History(robot, ()), 0
    newest = of_axis[-1][1]
    shared, used = set(newest.poses), 0
    for _, measured in reversed(of_axis):
        left = shared & set(measured.poses)
        if measured.calibration != newest.calibration or len(left) < _SHARED * len(newest.poses):
            break
        shared, used = left, used + 1
    kept = of_axis[len(of_axis) - used :]
    return History(robot, tuple(_measurement(one, measured, shared) for one, measured in kept)), len(of_axis) - used


def newest_ratio(robot: str, axis: str, campaigns: Sequence[CampaignMeasured]) -> tuple[History, float]:
    """The newest campaign's mean of log J over that of the robot file, in all its poses, and the gain's std."""
    for one in reversed(campaigns):
        measured = one.axes.get(axis)
        if measured is not None:
            values = list(measured.poses.values())
            mean = float(np.mean([value.log_ratio for value in values]))
            found = Measurement(one.id, mean, _std(values), measured.calibration)
            return History(robot, (found,)), measured.gain_std
    return History(robot, ()), 0.0


def _measurement(campaign: CampaignMeasured, measured: AxisMeasured, shared: set[Pose]) -> Measurement:
    values = [measured.poses[pose] for pose in sorted(shared)]
    mean = float(np.mean([value.log_value for value in values]))
    return Measurement(campaign.id, mean, _std(values), measured.calibration)


def _std(values: Sequence[InPose]) -> float:
    return float(np.sqrt(np.sum([value.std**2 for value in values])) / len(values))
