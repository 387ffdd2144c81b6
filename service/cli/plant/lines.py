"""Robots and jobs of a plant, one line each."""

from service.identification.fleet.document import Fleet, FleetRobot, FleetType
from service.store.plant import BatchDocument, BatchEntry


def fleet_lines(fleet: Fleet) -> list[str]:
    """What is printed: each type with its robots, or that there are none."""
    found = [line for one in fleet.types for line in (f"{one.name}: {_counts(one)}", *map(_robot, one.robots))]
    return found or ["no robot of this plant was measured yet"]


def _counts(one: FleetType) -> str:
    changed = sum(bool(robot.changed) for robot in one.robots)
    outliers = sum(bool(robot.outlier) for robot in one.robots)
    due = sum(robot.due for robot in one.robots)
    return f"{len(one.robots)} robots, {changed} changed, {outliers} outliers, {due} due"


def _robot(robot: FleetRobot) -> str:
    last = "never measured" if robot.measured_at is None else f"measured {robot.measured_at:%Y-%m-%d}"
    parts = [f"  {robot.label}: {last}, {robot.campaigns} campaigns"]
    if robot.due:
        parts.append("due")
    for axis, one in robot.axes.items():
        if one.change is not None and one.change.alarm:
            how = "drift" if one.change.since is None else f"step at campaign {one.change.since}"
            parts.append(f"{axis} changed by {one.change.change_percent:+.2f} % ({how})")
        if one.difference is not None and one.difference.outlier:
            by_gain = ", torque constant can explain it" if one.difference.by_gain else ""
            parts.append(f"{axis} differs by {one.difference.difference_percent:+.2f} % from the others{by_gain}")
    return ", ".join(parts)


def job_line(job: BatchDocument) -> str:
    """State and counts."""
    failed = f", {job.failed} without a result" if job.failed else ""
    done = f"{job.done} of {job.campaigns} campaigns, {job.sweeps} sweeps{failed}"
    return f"job {job.id} ({job.kind}, {job.machine}): {job.state.value}, {done}"


def result_line(one: BatchEntry) -> str:
    """Of one campaign of a job."""
    if one.cause:
        return f"  campaign {one.campaign_id}: no result: {one.cause}"
    change = "nothing to compare" if one.change_percent is None else f"J changed by {one.change_percent:.3g} % at most"
    return f"  campaign {one.campaign_id}: {one.sweeps} sweeps, {change}"
