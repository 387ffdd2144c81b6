"""The report of a plant: control charts of the robots of each type, changes, outliers, and overdue measurements."""

import math
from collections.abc import Sequence
from datetime import datetime
from html import escape

import numpy as np

from service.identification.fleet.document import Fleet, FleetAxis, FleetRobot, FleetType
from service.model.results.part import with_std
from service.report.drawing import DrawnFigure, Part, figure, line, looks, points, scale
from service.report.html import ReportPage

_NONE = "\u2013"


def fleet_page(fleet: Fleet, origin: Sequence[tuple[str, str]]) -> ReportPage:
    """The complete report; deterministic for equal content. `origin`: source of the data, and of the report."""
    robots = [robot for one in fleet.types for robot in one.robots]
    page = ReportPage("Robots of the plant", f"As of {_day(fleet.made_at)}.")
    page.facts(
        (
            (str(len(robots)), "robots"),
            (str(sum(bool(robot.changed) for robot in robots)), "changed"),
            (str(sum(bool(robot.outlier) for robot in robots)), "outliers"),
            (str(sum(robot.due for robot in robots)), "due for a measurement"),
        )
    )
    page.origin(origin)
    for one in fleet.types:
        _type_section(page, one)
    return page


def _type_section(page: ReportPage, one: FleetType) -> None:
    page.add(
        f"<h2>{escape(one.name)}</h2>",
        f"<p>The newest {one.campaigns} campaigns of each robot are compared. The probability of any false alarm among "
        f"all robots and axes in {one.campaigns} campaigns is at most {100 * one.probability:g} %. A robot is due "
        f"{one.remeasure_days:g} days after its last measurement.</p>",
    )
    head = ["robot", "machine", "campaigns", "last measured", "due", "changed axes", "outlier in axes"]
    page.table(head, [_robot_row(robot) for robot in one.robots])
    for axis in one.axes:
        robots = [robot for robot in one.robots if axis in robot.axes]
        page.add(
            f"<h3>{escape(axis)}</h3>",
            "<p>J of each campaign against the mean of the robot's series, with one standard deviation. Standard "
            f"deviation from campaign to campaign: {one.between_percent[axis]:.2f} %.</p>",
        )
        page.figure(control_chart(axis, robots))
        head = ["robot", "change in %", "\u00b1 std", "kind", "statistic (limit)", "alarm"]
        head += ["against the others in %", "outlier"]
        page.table(head, [_axis_row(robot.label, robot.axes[axis]) for robot in robots])


def control_chart(axis: str, robots: Sequence[FleetRobot]) -> DrawnFigure:
    """J of an axis over time, a line for each robot; the line of a robot that has changed is thick."""
    traces: list[Part] = []
    for robot, colour, symbol in looks(robots):
        series = robot.axes[axis].points
        days = [f"{one.at:%Y-%m-%d %H:%M}" for one in series]
        values = np.array([one.difference_percent for one in series])
        width = 3.0 if axis in robot.changed else 1.0
        traces.append({**line(robot.label, days, values, colour, width=width), "showlegend": False})
        error = np.array([one.std_percent for one in series])
        traces.append(points(robot.label, days, values, colour, error, symbol))
    layout = {
        "height": 420,
        "xaxis": {**scale("campaign"), "type": "category"},
        "yaxis": scale("change of J in %", True),
    }
    return figure(traces, layout)


def _robot_row(robot: FleetRobot) -> list[str]:
    return [
        robot.label,
        robot.machine or _NONE,
        str(robot.campaigns),
        _NONE if robot.measured_at is None else _day(robot.measured_at),
        _due(robot),
        ", ".join(robot.changed) or _NONE,
        ", ".join(robot.outlier) or _NONE,
    ]


def _due(robot: FleetRobot) -> str:
    if robot.due_at is None:
        return "now: never measured"
    return f"{'now: since' if robot.due else 'on'} {_day(robot.due_at)}"


def _axis_row(label: str, axis: FleetAxis) -> list[str]:
    change, other = axis.change, axis.difference
    cells = [label, *([_NONE] * 5 if change is None else ())]
    if change is not None:
        kind = "drift" if change.since is None else f"step from campaign {change.since}"
        cells += [
            *with_std(change.change_percent, change.std_percent, "+"),
            kind,
            f"{abs(change.statistic):.1f} ({change.limit:.1f})",
            "changed" if change.alarm else "no",
        ]
    if other is None or not math.isfinite(other.difference_percent):
        return [*cells, _NONE, _NONE]
    outlier = "no" if not other.outlier else "yes, the torque constant can explain it" if other.by_gain else "yes"
    return [*cells, f"{other.difference_percent:+.2f}", outlier]


def _day(at: datetime) -> str:
    return f"{at:%Y-%m-%d}"
