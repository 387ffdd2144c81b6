"""Reads the stored results of campaigns: those that a plan names, quality and confidence of an estimate, the fleet."""

from collections import defaultdict
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import lru_cache
from typing import Literal, cast

import structlog

from service import BadInput, NotFound
from service.identification.fleet.document import Fleet
from service.identification.fleet.survey import (
    AxisMeasured,
    CampaignMeasured,
    FleetRules,
    Pose,
    RobotMeasured,
    in_pose,
    pose_key,
    survey,
)
from service.model.results.estimate import Analyses, Estimate, EstimatedAxis
from service.store.documents import CampaignDocument, EstimateDocument
from service.store.plant import FleetStore, MeasuredCampaign
from service.store.store import Store


def _request(store: Store, campaign: CampaignDocument) -> Mapping[str, object]:
    """The request of a campaign's plan; {} without a plan."""
    return {} if campaign.plan_id is None else store.plan_request(campaign.plan_id)


def move_velocities(store: Store, campaigns: Sequence[int]) -> list[float]:
    """The velocities between poses that the plans of these campaigns ask for, rad/s (m/s)."""
    requests = [_request(store, store.campaign(campaign)) for campaign in campaigns]
    return [cast(float, request["move_velocity"]) for request in requests if "move_velocity" in request]


def _named(store: Store, campaign: CampaignDocument, field: Literal["analysis", "sweeps"]) -> int | None:
    """The campaign that this field of the plan's request names."""
    named = _request(store, campaign).get(field)
    return named if isinstance(named, int) else None


def campaign_beside(store: Store, campaign: CampaignDocument) -> CampaignDocument | None:
    """The campaign whose sweeps are combined with the trajectories of this one; None if there is none."""
    named = _named(store, campaign, "sweeps")
    return None if named is None else store.campaign(named)


def check_beside(store: Store, campaign_id: int, robot_id: int) -> None:
    """BadInput (field `sweeps`) if the campaign does not exist, or is of another robot."""
    try:
        campaign = store.campaign(campaign_id)
    except NotFound as error:
        raise BadInput("sweeps", str(error)) from None
    if campaign.robot_id != robot_id:
        raise BadInput("sweeps", f"campaign {campaign_id} measured robot {campaign.robot_id}, not robot {robot_id}")


def analysis_behind(store: Store, campaign: CampaignDocument) -> Analyses:
    """The initial analysis that a campaign uses, by joint; {} if there is none."""
    named = _named(store, campaign, "analysis")
    return {} if named is None else latest_analysis(store, named)


def latest_analysis(store: Store, campaign_id: int) -> Analyses:
    """The result of a campaign of an initial analysis; BadInput (field `analysis`) if it has none."""
    try:
        found = store.estimate(campaign_id).content.analysis
    except NotFound as error:
        raise BadInput("analysis", str(error)) from None
    if not found:
        raise BadInput("analysis", f"campaign {campaign_id} has no noise runs or stepped sines that were identified")
    return found


def siblings_behind(store: Store, campaign: CampaignDocument) -> dict[str, Estimate]:
    """The estimates of other robots of the type that a campaign uses; {} if there is none."""
    named = _request(store, campaign).get("prior_from")
    return siblings(
        store, [one for one in cast(list[object], named) if isinstance(one, int)] if isinstance(named, list) else []
    )


def siblings(store: Store, campaigns: Sequence[int]) -> dict[str, Estimate]:
    """The estimates of campaigns, by name; BadInput (field `prior_from`) for one that has none."""
    try:
        return {f"campaign {one}": store.estimate(one).content for one in campaigns}
    except NotFound as error:
        raise BadInput("prior_from", str(error)) from None


@dataclass(frozen=True, slots=True)
class AxisEstimateQuality:
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
    axes: dict[str, AxisEstimateQuality]


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


def _of_axis(axis: EstimatedAxis) -> AxisEstimateQuality:
    return AxisEstimateQuality(
        sweeps=len(axis.inertia),
        gap=axis.rmse_percent.reference_measured / 100,
        left=axis.rmse_percent.identified_measured / 100,
        std=None if axis.workspace_std_percent is None else axis.workspace_std_percent.median / 100,
    )


_log = structlog.get_logger(__name__)


def confidence_reached(estimate: Estimate, joints: Collection[str], parameters: int, wanted: float) -> str:
    """Why the campaign may end, or "" while it may not.

    `estimate`: its latest revision; `joints`: measured by the campaign; `parameters`: number of base parameters of
    its plan; `wanted`: largest standard deviation of J over the workspace, percent. An undetermined value never
    fulfils the criterion. Neither does an estimate with fewer parameters: it assumes that joints that have not moved
    yet are locked, and covers only the workspace of the others.
    """
    if len(estimate.base_parameters) < parameters:
        return ""
    percent = [estimate.axes[joint].confidence_percent for joint in joints if joint in estimate.axes]
    reached = [one for one in percent if one is not None]
    if len(reached) < len(joints) or max(reached) > wanted:
        return ""
    return f"confidence of {wanted:.4g} % reached: J is known to {max(reached):.3g} % over the workspace"


class FleetHistory:
    """Reads each estimate once: a revision never changes. Methods block and may be called from any thread."""

    def __init__(self, store: FleetStore) -> None:
        self._store = store
        self._of: Callable[[MeasuredCampaign], CampaignMeasured | None] = lru_cache(20_000)(
            self._read
        )  # 12 months of 1,000 robots

    def fleet(self, rules: FleetRules, at: datetime, name: str | None = None) -> Fleet:
        """The robots of one type, or of all types. NotFound if no robot has that name; BadInput for invalid rules."""
        names = self._store.types()
        if name is not None and name not in names:
            raise NotFound(f"there is no robot of the type {name!r}; the types are: {', '.join(names) or 'none'}")
        found = [(one, self._robots(one, rules.campaigns)) for one in (names if name is None else (name,))]
        types = [survey(one, robots, rules, at) for one, robots in found if robots or name is not None]
        return Fleet(made_at=at, types=tuple(types))

    def _robots(self, name: str, window: int) -> tuple[RobotMeasured, ...]:
        """All measured robots, and the robots with a serial number that were never measured."""
        by_robot: dict[tuple[str | None, str | None], list[MeasuredCampaign]] = defaultdict(list)
        for serial in self._store.serials(name):
            by_robot[serial, None] = []
        for one in self._store.measured(name):
            # a robot with a serial number may be measured at several machines
            by_robot[(one.robot.serial, None if one.robot.serial is not None else one.robot.machine)].append(one)
        robots: list[RobotMeasured] = []
        for (serial, machine), campaigns in by_robot.items():
            read = (self._of(one) for one in campaigns[-window:])
            where = campaigns[-1].robot.machine if campaigns else machine
            robots.append(RobotMeasured(serial, where, len(campaigns), tuple(one for one in read if one is not None)))
        return tuple(sorted(robots, key=lambda robot: (robot.serial or "", robot.machine or "")))

    def _read(self, campaign: MeasuredCampaign) -> CampaignMeasured | None:
        """The values of a campaign; None, with a line in the log, if its estimate cannot be read."""
        try:
            content = self._store.estimate(campaign).content
        except (BadInput, NotFound) as error:
            _log.warning("estimate_not_in_fleet", campaign=campaign.id, revision=campaign.revision, reason=str(error))
            return None
        poses = {sweep: pose_key(pose) for sweep, pose in self._store.poses(campaign.id).items()}
        axes = {joint: _axis(axis, poses) for joint, axis in content.axes.items()}
        return CampaignMeasured(campaign.id, campaign.at, {joint: one for joint, one in axes.items() if one.poses})


def _axis(axis: EstimatedAxis, poses: dict[str, Pose]) -> AxisMeasured:
    """The values of one axis, without sweeps that have no positive inertia, standard deviation or known pose."""
    grouped: dict[Pose, list[tuple[float, float, float]]] = defaultdict(list)
    for one in axis.inertia:
        if one.sweep in poses and min(one.value, one.reference, one.std) > 0:
            grouped[poses[one.sweep]].append((one.value, one.reference, one.std))
    return AxisMeasured(
        poses={pose: in_pose(*zip(*sweeps, strict=True)) for pose, sweeps in grouped.items()},
        calibration=axis.torque_gain.value,
        gain_std=axis.torque_gain.std,
    )
