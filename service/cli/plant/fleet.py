"""`sweepid fleet`: which robots of the plant have changed, differ from the others, or are due."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from service.cli.address import DEFAULT_URL, Url
from service.cli.campaign.tables import write_tables
from service.cli.documents import JsonTo, put_json, write_file
from service.cli.progress_indicator import waiting
from service.client import ServiceClient
from service.fleet.document import Fleet, FleetRobot, FleetType

Form = Literal["html", "pdf", "json"]


def fleet(
    type_name: Annotated[
        str | None, typer.Option("--type", help="Name of the robots; default: all types.", metavar="NAME")
    ] = None,
    json_to: JsonTo = None,
    report: Annotated[Path | None, typer.Option(help="Write the report as HTML.", metavar="FILE")] = None,
    pdf: Annotated[Path | None, typer.Option(help="Write the report as PDF (A4).", metavar="FILE")] = None,
    tables: Annotated[Path | None, typer.Option(help="Write its tables here, CSV and JSON.", metavar="DIR")] = None,
    url: Url = DEFAULT_URL,
) -> None:
    """Print a line for each robot of the plant: last measurement, changes, difference from robots of its type."""
    wanted: list[tuple[Form, Path | None]] = [("html", report), ("pdf", pdf), ("json", tables)]
    with ServiceClient(url) as client, waiting("reading the estimates of the plant"):
        found = Fleet.model_validate(client.fleet(type_name))
        written = [(form, path, client.fleet_report(type_name, form)) for form, path in wanted if path is not None]
    for form, path, content in written:
        if form == "json":
            write_tables(path, content)
        else:
            write_file(path, content)
    if not put_json(found, json_to):
        for line in lines(found):
            typer.echo(line)


def lines(fleet: Fleet) -> list[str]:
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
