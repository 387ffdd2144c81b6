"""A plant as a whole: many machines, robots and campaigns."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.terminal import DEFAULT_URL, JsonTo, Url, connect, put_json, waiting, write_report

if TYPE_CHECKING:
    from service.identification.fleet.document import Fleet, FleetRobot, FleetType
    from service.web.client import Json

Job = Annotated[int, typer.Argument(metavar="JOB", help="Number of the job.", min=1, show_default=False)]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON lines.")]


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
    from service.identification.fleet.document import Fleet

    wanted = [("html", report), ("pdf", pdf), ("json", tables)]
    with connect(url) as client, waiting("reading the estimates of the plant"):
        found = Fleet.model_validate(client.fleet(type_name))
        written = [(form, path, client.fleet_report(type_name, form)) for form, path in wanted if path is not None]
    for form, path, content in written:
        write_report(form, path, content)
    if not put_json(found, json_to):
        for line in fleet_lines(found):
            typer.echo(line)


def reidentify(
    campaign: Annotated[list[int] | None, typer.Option(help="Only this one, again for more; default: all.")] = None,
    wait: Annotated[bool, typer.Option("--wait", help="Return when it is over; Ctrl-C does not cancel it.")] = False,
    url: Url = DEFAULT_URL,
) -> None:
    """Identify stored campaigns of the service's machine again; prints the job. Stored estimates stay as they are."""
    with connect(url) as client:
        job = client.add_job(campaign)
        if wait:
            with waiting(f"job {job['id']}: {job['campaigns']} campaigns"):
                job = client.job_over(int(job["id"]))
    typer.echo(job_line(job))


def list_jobs(as_json: AsJson = False, url: Url = DEFAULT_URL) -> None:
    """Print a line for each job of the plant, the oldest first."""
    with connect(url) as client:
        for job in client.jobs():
            typer.echo(json.dumps(job) if as_json else job_line(job))


def show(job: Job, as_json: AsJson = False, url: Url = DEFAULT_URL) -> None:
    """Print a job and a line for each campaign that is done: largest change of J, or why there is no result."""
    with connect(url) as client:
        found, results = client.job(job), client.job_results(job)
    if as_json:
        sys.stdout.writelines(f"{json.dumps(one)}\n" for one in (found, *results))
        return
    typer.echo(job_line(found))
    for one in results:
        typer.echo(result_line(one))


def cancel(job: Job, url: Url = DEFAULT_URL) -> None:
    """Compute no more of a job; what was computed stays."""
    with connect(url) as client:
        typer.echo(job_line(client.cancel_job(job)))


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


def job_line(document: Json) -> str:
    """State and counts of a job."""
    from service.store.plant import BatchDocument

    job = BatchDocument.model_validate(document)
    failed = f", {job.failed} without a result" if job.failed else ""
    done = f"{job.done} of {job.campaigns} campaigns, {job.sweeps} sweeps{failed}"
    return f"job {job.id} ({job.kind}, {job.machine}): {job.state.value}, {done}"


def result_line(document: Json) -> str:
    """Of one campaign of a job."""
    from service.store.plant import BatchEntry

    one = BatchEntry.model_validate(document)
    if one.cause:
        return f"  campaign {one.campaign_id}: no result: {one.cause}"
    change = "nothing to compare" if one.change_percent is None else f"J changed by {one.change_percent:.3g} % at most"
    return f"  campaign {one.campaign_id}: {one.sweeps} sweeps, {change}"
