"""`sweepid export CAMPAIGN DIR`: a bundle out of the service."""

import sys
import tempfile
import zipfile
from pathlib import Path
from typing import Annotated

import typer

from service.cli.address import DEFAULT_URL, Url
from service.cli.progress_indicator import waiting
from service.client import ServiceClient
from service.errors import BadInput


def campaign_number(text: str) -> int:
    """The number of a campaign; an error tells the other commands that export."""
    if text.isascii() and text.isdecimal() and int(text) >= 1:
        return int(text)
    raise typer.BadParameter(
        f"{text!r} is not the number of a campaign. For the values of a control use `sweepid export-sheet`, "
        "for URDF and MJCF `sweepid export-model`"
    )


def export_bundle(
    campaign: Annotated[int, typer.Argument(parser=campaign_number, help="Number of a campaign.")],
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder to write; must be empty or not exist.")],
    url: Url = DEFAULT_URL,
) -> None:
    """Write the recorded sweeps of a campaign as a bundle. Prints the folder."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise BadInput(str(folder), "exists already and is not an empty folder")
    with ServiceClient(url) as client, tempfile.TemporaryDirectory() as temporary:
        archive = Path(temporary) / "bundle.zip"
        with waiting("the service packs the recordings"):
            client.export_bundle(campaign, archive)
        with zipfile.ZipFile(archive) as content:
            content.extractall(folder)
    sys.stdout.write(f"{folder}\n")
