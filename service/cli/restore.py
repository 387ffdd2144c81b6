"""`sweepid restore BACKUP --data-dir EMPTY`: a data folder of a backup that is whole."""

import signal
from pathlib import Path
from typing import Annotated

import typer

from service.backup.restoring import restore as restore_backup
from service.cli.progress_indicator import waiting


def restore(
    backup: Annotated[Path, typer.Argument(help="Folder that `sweepid backup` made.", show_default=False)],
    data_dir: Annotated[Path, typer.Option(help="Folder to make; must be empty or not exist.", show_default=False)],
) -> None:
    """Check all of a backup, then make a data folder of it, on which the service can be started. Prints the folder."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # as Ctrl-C: nothing is left
    with waiting("the check and the copy"):
        manifest = restore_backup(backup, data_dir)
    for stream in manifest.streams_left_out:
        typer.echo(f"not in the backup, was still being written: {stream}", err=True)
    if manifest.in_store:
        typer.echo(f"{len(manifest.in_store)} recordings are in the object store: set `recordings_url`", err=True)
    typer.echo(str(data_dir))
