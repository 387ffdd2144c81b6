"""A campaign run through the service and watched on the terminal."""

import sys
from pathlib import Path
from typing import cast

from pydantic import BaseModel, ConfigDict
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from service.cli.termination_signals import TerminationSignals
from service.model.causes import in_words, read
from service.model.errors import BadInput, SweepidError
from service.planning.campaigns.stored_plan import PlanSubject
from service.web.client import Json, ServiceClient


class _PlanFile(BaseModel):
    """What `sweepid plan --out` writes; only the number matters here."""

    model_config = ConfigDict(frozen=True, extra="ignore")
    id: int


class NotCompleted(SweepidError):
    """The campaign holds or was given up before all its sweeps were identified; the message says why."""


def run_plan(plan: str, url: str) -> int:
    """Move, measure, identify; the number of the campaign. A signal that ends the program stops the machine first."""
    with ServiceClient(url) as client:
        campaign_id = int(client.add_campaign(plan_number(plan))["id"])
        with TerminationSignals() as signals:
            try:
                client.start(campaign_id, seen=tell_motion(client, campaign_id))
                watch(client, campaign_id)
            except BaseException:  # also what a terminal that is gone made of it
                if not signals.by:
                    raise
                raise _stopped(client, campaign_id, signals.by, url) from None
    return campaign_id


def tell_motion(client: ServiceClient, campaign_id: int) -> Json:
    """Print what the start will move, from where the axes stand; returns the ranges. Connects the drives for it."""
    if not client.drives()["connected"]:
        client.connect()
    ahead = client.ahead(campaign_id)
    if ahead["refused"]:
        raise NotCompleted(ahead["refused"])
    told = [PlanSubject.model_validate(ahead["subject"]).sentence]
    moves = ", ".join(f"{leg['joint']} to {leg['target']:.4g}" for leg in ahead["approach"])
    told.append(f"approach not known: {ahead['trouble']}" if ahead["trouble"] else f"approach: {moves or 'none'}")
    told += [f"{joint} between {low:.4g} and {high:.4g} rad (m)" for joint, (low, high) in ahead["range"].items()]
    sys.stderr.write("".join(f"{line}\n" for line in told))
    return cast("Json", ahead["range"])


def _stopped(client: ServiceClient, campaign_id: int, why: str, url: str) -> NotCompleted:
    """Stop the machine; the error to report."""
    then = f"release the stop and resume or abort the campaign at {url}"
    try:
        client.stop("sweepid measure", why)
    except SweepidError as error:
        return NotCompleted(f"campaign {campaign_id}: THE STOP IS NOT CONFIRMED: {error}; look at the machine, {then}")
    return NotCompleted(f"campaign {campaign_id}: machine stopped; {then}")


LARGEST_PLAN = 2**26  # bytes


def plan_number(plan: str) -> int:
    """The number of a plan given as such or as the file of a plan."""
    if plan.isascii() and plan.isdigit():
        return int(plan)
    try:
        with Path(plan).open("rb") as file:
            content = file.read(LARGEST_PLAN + 1)
        if len(content) > LARGEST_PLAN:
            raise BadInput(plan, f"is larger than {LARGEST_PLAN} bytes")
        return _PlanFile.model_validate_json(content).id
    except OSError as error:
        raise BadInput(plan, f"neither the number of a plan nor a readable file: {error.strerror}") from None
    except ValueError:
        raise BadInput(plan, "is not a plan that `sweepid plan --out` wrote") from None


def watch(client: ServiceClient, campaign_id: int) -> None:
    """Show the campaign's progress on the terminal until it is completed; NotCompleted if it will not be."""
    columns = (
        TextColumn("campaign {task.fields[campaign]}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.description}"),
    )
    with Progress(*columns, console=Console(stderr=True)) as bars:
        bar = bars.add_task("", campaign=campaign_id, total=None)
        # all events from the first on, so none is missed between starting and listening
        for event in client.events(campaign_id):
            if event["kind"] == "estimate":
                continue
            campaign = client.campaign(campaign_id)
            progress = campaign["progress"]
            bars.update(bar, total=progress["total"], completed=progress["done"], description=_doing(campaign))
            if campaign["state"] == "completed":
                return
            if campaign["state"] in ("paused", "aborted"):
                cause = campaign["structured_cause"]
                why = campaign["cause"] or "by command" if cause is None else in_words(read(cause))
                raise NotCompleted(f"campaign {campaign_id} {campaign['state']}: {why}")


def _doing(campaign: Json) -> str:
    """Remaining time and sweep; which axis moves at this moment changes faster than its events."""
    progress = campaign["progress"]
    current, remaining = progress["current"], progress["remaining"]
    if current is None:
        return "identifying" if campaign["state"] == "measured" else campaign["state"]
    left = "" if remaining is None else f"{int(remaining // 60)}:{int(remaining % 60):02d} left, "
    return f"{left}sweep {current['number']} of {current['spec']['axis']}, with the path to its pose"
