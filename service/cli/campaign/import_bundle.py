"""`sweepid import BUNDLE`: a bundle into the service."""

import asyncio
import sys
import tempfile
import zipfile
from pathlib import Path
from typing import Annotated

import typer

from service.cli.address import DEFAULT_URL, Url
from service.cli.progress_indicator import waiting
from service.cli.recordings.check import as_lines
from service.client import ServiceClient
from service.data_check import check
from service.errors import BadInput
from service.store.files.intake import read_from
from service.store.files.isolated_reader import read_isolated


def import_bundle(
    bundle: Annotated[Path, typer.Argument(help="Folder of a bundle, or a zip of it.")],
    url: Url = DEFAULT_URL,
) -> None:
    """Bring measured sweeps into the service, which identifies them. Prints the number of the campaign.

    What a check of the data finds goes to stderr.
    """
    with ServiceClient(url) as client, tempfile.TemporaryDirectory() as folder:
        archive = _pack(bundle, Path(folder) / "bundle.zip") if bundle.is_dir() else bundle
        if not zipfile.is_zipfile(archive):
            raise BadInput(str(bundle), "is neither the folder of a bundle nor a zip file")
        with waiting("the service reads the bundle"):
            campaign = client.import_bundle(archive)
        sys.stdout.write(f"{campaign['id']}\n")
        try:
            lines: list[str] = asyncio.run(read_isolated(found, (bundle, Path(folder) / "bundle"), str(bundle)))
        except BadInput as error:  # it is imported all the same, and the service checks it too
            lines = [f"not checked: {error}"]
        for line in lines:
            typer.echo(line, err=True)


def found(source: Path, folder: Path) -> list[str]:
    """What a check of the data finds, one line each; a zip is unpacked into `folder`."""
    measured = read_from(source, folder)
    return as_lines(check(measured.robot, measured.sweeps))


def _pack(folder: Path, target: Path) -> Path:
    if not (folder / "bundle.json").is_file():
        raise BadInput(str(folder / "bundle.json"), "does not exist")
    with zipfile.ZipFile(target, "w", zipfile.ZIP_STORED) as archive:  # Parquet is compressed already
        for path in sorted(folder.rglob("*")):
            archive.write(path, path.relative_to(folder))
    return target
