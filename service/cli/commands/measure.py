"""`sweepid measure PLAN`: run a plan through the service and watch it."""

import sys
from typing import Annotated

import typer

from service.cli.options import DEFAULT_URL, Url


def measure(
    plan: Annotated[str, typer.Argument(help="Number of a plan, or the file that `sweepid plan --out` wrote.")],
    url: Url = DEFAULT_URL,
) -> None:
    """Run a plan: move, measure, identify. Prints the number of the campaign.

    Ctrl-C, SIGTERM and a terminal that goes away stop the machine.
    """
    from service.cli.campaign.measure import run_plan

    sys.stdout.write(f"{run_plan(plan, url)}\n")
