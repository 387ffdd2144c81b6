"""`sweepid report CAMPAIGN FILE`: the report of a campaign of the service, as one page."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from service.cli.address import DEFAULT_URL, Url
from service.cli.documents import write_file
from service.cli.waiting import waiting
from service.client import ServiceClient


def report(
    campaign: Annotated[int, typer.Argument(min=1, help="Number of a campaign.")],
    file: Annotated[Path, typer.Argument(metavar="FILE", help="HTML file to write.")],
    url: Url = DEFAULT_URL,
) -> None:
    """Write the report of a campaign: verdict, origin, figures, tables and findings. Prints the file."""
    with ServiceClient(url) as client, waiting("the service draws the report"):
        page = client.campaign_report(campaign)
    write_file(file, page)
    sys.stdout.write(f"{file}\n")
