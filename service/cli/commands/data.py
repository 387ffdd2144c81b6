"""The data of the service: backup, restoration, examination, and the database as a whole."""

import getpass
import json
import os
import signal
from pathlib import Path
from typing import Annotated

import typer

from service.cli.options import Config, DataDir
from service.model.errors import BadInput

_NICE = 10  # it gives way to the process that streams set-points
_URL = "sqlite:///PATH or postgresql+psycopg://USER@HOST/NAME, without a password"
Campaign = Annotated[int, typer.Argument(metavar="CAMPAIGN", help="Its number.", min=1, show_default=False)]


def backup(
    target: Annotated[Path, typer.Argument(help="Folder to make; must not exist.", show_default=False)],
    config: Config = None,
    data_dir: DataDir = None,
) -> None:
    """Copy database and recordings, each with its SHA-256, into a folder; the service may run and measure."""
    from service.cli.progress_indicator import waiting
    from service.cli.settings_of import settings_of
    from service.store.backup import make_backup, sqlite_file

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


def restore(
    backup: Annotated[Path, typer.Argument(help="Folder that `sweepid data backup` made.", show_default=False)],
    data_dir: Annotated[Path, typer.Option(help="Folder to make; must be empty or not exist.", show_default=False)],
) -> None:
    """Check all of a backup, then make a data folder of it, on which the service can be started. Prints the folder."""
    from service.cli.progress_indicator import waiting
    from service.store.backup import restore as restore_backup

    signal.signal(signal.SIGTERM, signal.default_int_handler)  # as Ctrl-C: nothing is left
    with waiting("the check and the copy"):
        manifest = restore_backup(backup, data_dir)
    for stream in manifest.streams_left_out:
        typer.echo(f"not in the backup, was still being written: {stream}", err=True)
    if manifest.in_store:
        typer.echo(f"{len(manifest.in_store)} recordings are in the object store: set `recordings_url`", err=True)
    typer.echo(str(data_dir))


def doctor(config: Config = None, data_dir: DataDir = None) -> None:
    """Read the database and every file that it names; print a line a finding, with what to do. Exit code 1 if any.

    Recordings that are in an object store are read there. Nothing is changed; the service may run.
    """
    from service.cli.progress_indicator import waiting
    from service.cli.settings_of import settings_of
    from service.store.examination import examine, examined

    settings = settings_of(config, data_dir)
    database = examined(settings.url, settings.database_password_file)
    with waiting("the examination"):
        findings = examine(database, settings.data_dir, settings.least_free_disk, settings.recordings_store)
    for finding in findings:
        typer.echo(finding.line)
    raise typer.Exit(code=min(len(findings), 1))


def copy(
    source: Annotated[str, typer.Option("--from", help=f"URL to copy from: {_URL}.", show_default=False)],
    target: Annotated[str, typer.Option("--to", help="URL of an empty database to copy to.", show_default=False)],
    from_password_file: Annotated[Path | None, typer.Option(help="Password of --from; default: PGPASSFILE.")] = None,
    to_password_file: Annotated[Path | None, typer.Option(help="Password of --to; default: PGPASSFILE.")] = None,
) -> None:
    """Copy every row, then compare counts and a hash of every row. The service must not run. All or nothing.

    stdout: how many rows.
    """
    from service.cli.progress_indicator import waiting
    from service.process.settings import Settings
    from service.store.copying import copy_rows
    from service.store.database import open_database
    from service.store.engines import parsed_url

    file = parsed_url(source)
    if file.get_backend_name() == "sqlite" and not Path(file.database or "").is_file():
        raise BadInput("--from", f"database {file.database} does not exist")
    with (
        waiting("the copy"),
        open_database(source, from_password_file, machine=None) as old,
        open_database(target, to_password_file, machine=None) as new,
    ):
        rows = copy_rows(old, new, Settings().lease_time, _tell)
    typer.echo(f"{rows} rows")


def _tell(table: str, rows: int) -> None:
    typer.echo(f"{table}: {rows} rows", err=True)


def prune(
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only print what would be removed.")] = False,
    config: Config = None,
    data_dir: DataDir = None,
) -> None:
    """Remove samples, spectra and estimates of the data folder's machine that are older than the settings keep them.

    Settings: keep_samples_days, keep_spectra_days, keep_estimates_days. The service may run. stdout: a line a campaign.
    """
    from service.cli.database.retention import prune_data

    prune_data(config, data_dir, dry_run)


def hold(
    campaign: Campaign,
    why: Annotated[str, typer.Option(help="As: report signed by Ada, 2026-11-25.", show_default=False)],
    config: Config = None,
    data_dir: DataDir = None,
) -> None:
    """Never remove anything of a campaign, because a signed report or a decision rests on it."""
    from service.cli.database.retention import retention
    from service.cli.people.open_database import shell_entry

    with retention(config, data_dir) as (store, _):
        held = store.hold(campaign, getpass.getuser(), why, shell_entry())
    typer.echo(f"campaign {held.campaign_id} is held by {held.by}: {held.why}")


def release(campaign: Campaign, config: Config = None, data_dir: DataDir = None) -> None:
    """Let the retention rule apply to a held campaign again."""
    from service.cli.database.retention import retention
    from service.cli.people.open_database import shell_entry

    with retention(config, data_dir) as (store, _):
        store.release(campaign, shell_entry())
    typer.echo(f"campaign {campaign} is released: the retention rule applies to it")


def holds(config: Config = None, data_dir: DataDir = None) -> None:
    """Print one JSON line for each held campaign."""
    from service.cli.database.retention import retention

    with retention(config, data_dir) as (store, _):
        for one in store.holds():
            typer.echo(json.dumps(one.model_dump(mode="json")))
