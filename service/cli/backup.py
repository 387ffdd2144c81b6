"""`sweepid backup TARGET`: a consistent copy of database and recordings, also while the service measures."""

import os
import signal
from pathlib import Path
from typing import Annotated

import typer

from service.backup.making import make_backup
from service.cli.progress_indicator import waiting
from service.settings import Settings, load_settings
from service.store.snapshot import sqlite_file

Config = Annotated[Path | None, typer.Option(help="Settings; default: config/service.yaml, if it exists.")]
DataDir = Annotated[Path | None, typer.Option(help="Database and recordings; default: that of the settings.")]
_NICE = 10  # it gives way to the process that streams set-points


def backup(
    target: Annotated[Path, typer.Argument(help="Folder to make; must not exist.", show_default=False)],
    config: Config = None,
    data_dir: DataDir = None,
) -> None:
    """Copy database and recordings, each with its SHA-256, into a folder; the service may run and measure."""
    settings = settings_of(config, data_dir)
    if hasattr(os, "nice"):
        os.nice(_NICE)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # as Ctrl-C: nothing is left
    with waiting("the copy"):
        manifest = make_backup(sqlite_file(settings.url), settings.data_dir, target)
    for stream in manifest.streams_left_out:
        typer.echo(f"left out, still being written: {stream}", err=True)
    if manifest.in_store:
        typer.echo(f"listed, not copied: {len(manifest.in_store)} recordings in the object store", err=True)
    typer.echo(f"{target}: {len(manifest.files)} files, {manifest.size} bytes")


def settings_of(config: Path | None, data_dir: Path | None) -> Settings:
    """As `sweepid serve` takes them."""
    return load_settings(config).model_copy(update={} if data_dir is None else {"data_dir": data_dir})
