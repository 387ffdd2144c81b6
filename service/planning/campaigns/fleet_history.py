"""The robots of a plant as input of the fleet's computation, from the stored estimates of all machines."""

from collections import defaultdict
from collections.abc import Callable
from datetime import datetime
from functools import lru_cache

import structlog

from service.identification.fleet.document import Fleet
from service.identification.fleet.series import AxisMeasured, CampaignMeasured, Pose, in_pose, pose_key
from service.identification.fleet.survey import RobotMeasured, Rules, survey
from service.model.errors import BadInput, NotFound
from service.model.results.estimate import EstimatedAxis
from service.store.plant import FleetStore, MeasuredCampaign

_log = structlog.get_logger(__name__)

_KEPT = 20_000  # campaigns whose values stay in memory: a little more than 12 months of 1,000 robots


class FleetHistory:
    """Reads each estimate once: a revision never changes. Methods block and may be called from any thread."""

    def __init__(self, store: FleetStore) -> None:
        self._store = store
        self._of: Callable[[MeasuredCampaign], CampaignMeasured | None] = lru_cache(maxsize=_KEPT)(self._read)

    def fleet(self, rules: Rules, at: datetime, name: str | None = None) -> Fleet:
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
