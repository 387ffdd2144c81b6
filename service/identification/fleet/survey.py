"""Robots of one type over their campaigns: changes, outliers, and due measurements."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np

from service.identification.fleet.document import (
    FleetAxis,
    FleetChange,
    FleetDifference,
    FleetPoint,
    FleetRobot,
    FleetType,
)
from service.identification.fleet.statistics import (
    AlarmRate,
    Between,
    CampaignValue,
    History,
    Look,
    Sibling,
    between_campaigns,
    looks,
    outliers,
)

Pose = tuple[int, ...]


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
    # rad (m)
    return tuple(round(position / 0.01) for position in pose)


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
        # fewer than half of the newest campaign's poses
        if measured.calibration != newest.calibration or len(left) < 0.5 * len(newest.poses):
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
            found = CampaignValue(one.id, mean, _std(values), measured.calibration)
            return History(robot, (found,)), measured.gain_std
    return History(robot, ()), 0.0


def _measurement(campaign: CampaignMeasured, measured: AxisMeasured, shared: set[Pose]) -> CampaignValue:
    values = [measured.poses[pose] for pose in sorted(shared)]
    mean = float(np.mean([value.log_value for value in values]))
    return CampaignValue(campaign.id, mean, _std(values), measured.calibration)


def _std(values: Sequence[InPose]) -> float:
    return float(np.sqrt(np.sum([value.std**2 for value in values])) / len(values))


@dataclass(frozen=True, slots=True)
class FleetRules:
    """Configuration: the false-alarm probability of a time of `campaigns`, and days between measurements."""

    probability: float
    campaigns: int
    remeasure_days: float


@dataclass(frozen=True, slots=True)
class RobotMeasured:
    """A robot and its campaigns, the oldest first. `measured`: their total number, including those not given here."""

    serial: str | None
    machine: str | None
    measured: int
    campaigns: tuple[CampaignMeasured, ...]


@dataclass(frozen=True, slots=True)
class _AxisSurvey:
    """One axis of all robots, by the number of the robot."""

    histories: Mapping[str, History]
    left_out: Mapping[str, int]
    between: Between
    looks: Mapping[str, Look | None]
    siblings: Mapping[str, Sibling]


def survey(name: str, robots: Sequence[RobotMeasured], rules: FleetRules, at: datetime) -> FleetType:
    """The robots of the type `name` at the time `at`. BadInput for impossible rules."""
    axes = list(dict.fromkeys(axis for robot in robots for one in robot.campaigns for axis in one.axes))
    rate = AlarmRate(rules.probability, max(1, len(robots)), max(1, len(axes)), rules.campaigns)
    found = {axis: _axis(axis, robots, rate) for axis in axes}
    return FleetType(
        name=name,
        probability=rules.probability,
        campaigns=rules.campaigns,
        remeasure_days=rules.remeasure_days,
        axes=tuple(axes),
        between_percent={axis: 100 * float(np.sqrt(one.between.variance)) for axis, one in found.items()},
        robots=tuple(_robot(str(number), robot, found, rules, at) for number, robot in enumerate(robots)),
    )


def _axis(axis: str, robots: Sequence[RobotMeasured], rate: AlarmRate) -> _AxisSurvey:
    made = {str(number): series(str(number), axis, robot.campaigns) for number, robot in enumerate(robots)}
    histories = {key: history for key, (history, _) in made.items()}
    ratios = [newest_ratio(str(number), axis, robot.campaigns) for number, robot in enumerate(robots)]
    gains = {history.robot: gain for history, gain in ratios}
    found = outliers([history for history, _ in ratios], rate.probability, rate.quantities, gains)
    return _AxisSurvey(
        histories=histories,
        left_out={key: left for key, (_, left) in made.items()},
        between=between_campaigns(list(histories.values())),
        looks=looks(list(histories.values()), rate),
        siblings={one.robot: one for one in found},
    )


def _robot(
    key: str, robot: RobotMeasured, axes: Mapping[str, _AxisSurvey], rules: FleetRules, at: datetime
) -> FleetRobot:
    own = {axis: _document(key, found, robot) for axis, found in axes.items() if found.histories[key].measurements}
    last = robot.campaigns[-1].at if robot.campaigns else None
    due_at = None if last is None else last + timedelta(days=rules.remeasure_days)
    return FleetRobot(
        serial=robot.serial,
        machine=robot.machine,
        campaigns=robot.measured,
        measured_at=last,
        due_at=due_at,
        due=due_at is None or at >= due_at,
        changed=tuple(axis for axis, one in own.items() if one.change is not None and one.change.alarm),
        outlier=tuple(axis for axis, one in own.items() if one.difference is not None and one.difference.outlier),
        axes=own,
    )


def _document(key: str, axis: _AxisSurvey, robot: RobotMeasured) -> FleetAxis:
    history = axis.histories[key]
    times = {one.id: one.at for one in robot.campaigns}
    values, variances = history.arrays()
    middle = float(values.mean())
    look, sibling = axis.looks[key], axis.siblings.get(key)
    return FleetAxis(
        points=tuple(
            FleetPoint(
                campaign=one.campaign,
                at=times[one.campaign],
                difference_percent=_percent(one.value - middle),
                std_percent=100 * float(np.sqrt(variance + axis.between.variance)),
            )
            for one, variance in zip(history.comparable, variances, strict=True)
        ),
        left_out=axis.left_out[key],
        change=None if look is None else _change(look),
        difference=None if sibling is None else _difference(sibling),
    )


def _change(look: Look) -> FleetChange | None:
    if not np.isfinite(look.limit):
        return None
    return FleetChange(
        since=look.since,
        change_percent=_percent(look.change),
        std_percent=100 * look.std,
        statistic=look.statistic,
        limit=look.limit,
        alarm=look.alarm,
    )


def _difference(sibling: Sibling) -> FleetDifference:
    return FleetDifference(
        difference_percent=_percent(sibling.difference),
        probability=sibling.probability,
        outlier=sibling.outlier,
        by_gain=sibling.by_gain,
    )


def _percent(log: float) -> float:
    """Percent, from a difference of logarithms."""
    return 100 * float(np.expm1(log))
