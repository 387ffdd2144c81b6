"""`sweepid jobs`: stored campaigns identified again on the workers, with progress and cancel."""

import json
import sys
from typing import Annotated

import typer

from service.cli.address import DEFAULT_URL, Url
from service.cli.progress_indicator import waiting
from service.client import ServiceClient
from service.store.plant.batches import BatchDocument, BatchEntry

jobs = typer.Typer(no_args_is_help=True, rich_markup_mode=None, help="Heavy computations over stored campaigns.")

Job = Annotated[int, typer.Argument(metavar="JOB", help="Number of the job.", min=1, show_default=False)]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON lines.")]


@jobs.command("reidentify")
def reidentify(
    campaign: Annotated[list[int] | None, typer.Option(help="Only this one, again for more; default: all.")] = None,
    wait: Annotated[bool, typer.Option("--wait", help="Return when it is over; Ctrl-C does not cancel it.")] = False,
    url: Url = DEFAULT_URL,
) -> None:
    """Identify stored campaigns of the service's machine again; prints the job. Stored estimates stay as they are."""
    with ServiceClient(url) as client:
        job = client.add_job(campaign)
        if wait:
            with waiting(f"job {job['id']}: {job['campaigns']} campaigns"):
                job = client.job_over(int(job["id"]))
    typer.echo(_line(BatchDocument.model_validate(job)))


@jobs.command("list")
def list_jobs(as_json: AsJson = False, url: Url = DEFAULT_URL) -> None:
    """Print a line for each job of the plant, the oldest first."""
    with ServiceClient(url) as client:
        for job in client.jobs():
            typer.echo(json.dumps(job) if as_json else _line(BatchDocument.model_validate(job)))


@jobs.command("show")
def show(job: Job, as_json: AsJson = False, url: Url = DEFAULT_URL) -> None:
    """Print a job and a line for each campaign that is done: largest change of J, or why there is no result."""
    with ServiceClient(url) as client:
        found, results = client.job(job), client.job_results(job)
    if as_json:
        sys.stdout.writelines(f"{json.dumps(one)}\n" for one in (found, *results))
        return
    typer.echo(_line(BatchDocument.model_validate(found)))
    for one in results:
        typer.echo(_result(BatchEntry.model_validate(one)))


@jobs.command("cancel")
def cancel(job: Job, url: Url = DEFAULT_URL) -> None:
    """Compute no more of a job; what was computed stays."""
    with ServiceClient(url) as client:
        typer.echo(_line(BatchDocument.model_validate(client.cancel_job(job))))


def _line(job: BatchDocument) -> str:
    failed = f", {job.failed} without a result" if job.failed else ""
    done = f"{job.done} of {job.campaigns} campaigns, {job.sweeps} sweeps{failed}"
    return f"job {job.id} ({job.kind}, {job.machine}): {job.state.value}, {done}"


def _result(one: BatchEntry) -> str:
    if one.cause:
        return f"  campaign {one.campaign_id}: no result: {one.cause}"
    change = "nothing to compare" if one.change_percent is None else f"J changed by {one.change_percent:.3g} % at most"
    return f"  campaign {one.campaign_id}: {one.sweeps} sweeps, {change}"
