"""The data of the service: backup, restoration, examination, and the database as a whole."""

from __future__ import annotations

import getpass
import json
import os
import signal
from collections.abc import Generator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service import BadInput
from service.cli.terminal import Config, DataDir, shell_entry, waiting

if TYPE_CHECKING:
    from service.process.settings import Settings
    from service.store.retention import Doomed, RetentionStore

_URL = "sqlite:///PATH or postgresql+psycopg://USER@HOST/NAME, without a password"
Campaign = Annotated[int, typer.Argument(metavar="CAMPAIGN", help="Its number.", min=1, show_default=False)]


def backup(
    target: Annotated[Path, typer.Argument(help="Folder to make; must not exist.", show_default=False)],
    config: Config = None,
    data_dir: DataDir = None,
) -> None:
    """Copy database and recordings, each with its SHA-256, into a folder; the service may run and measure."""
    from service.cli.database import settings_of
    from service.store.back_up import make_backup, sqlite_file

    settings = settings_of(config, data_dir)
    if hasattr(os, "nice"):
        os.nice(10)  # it gives way to the process that streams set-points
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
    from service.store.back_up import restore as restore_backup

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
    from service.cli.database import settings_of
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
    from service.process.settings import Settings
    from service.store.copying import copy_rows
    from service.store.database import open_database, parsed_url

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
    from service.store.objects import ObjectStore
    from service.store.retention import RetentionRules, prune as prune_store

    with _retention(config, data_dir) as (store, settings):
        rules = RetentionRules(settings.keep_samples_days, settings.keep_spectra_days, settings.keep_estimates_days)
        if rules == RetentionRules(None, None, None):
            raise BadInput(
                "settings", "keep everything: set `keep_samples_days`, `keep_spectra_days` or `keep_estimates_days`"
            )
        address = settings.recordings_store
        objects = None if address is None else ObjectStore(address)
        entry = None if dry_run else shell_entry()
        found = prune_store(store, settings.data_dir, objects, rules, datetime.now(UTC), entry, _tell_doomed)
    for campaign, why in sorted(found.stay.items()):
        typer.echo(f"campaign {campaign} is kept: {why}", err=True)
    typer.echo(
        f"{'would be removed' if dry_run else 'removed'}: {found.recordings} recordings, {found.spectra} spectra, "
        f"{found.estimates} estimates of {found.campaigns} campaigns, {found.bytes} bytes"
    )


def _tell_doomed(one: Doomed) -> None:
    parts = f"{len(one.samples)} recordings, {len(one.spectra)} spectra, {len(one.estimates)} estimates"
    typer.echo(f"campaign {one.campaign_id}: {parts}")


def hold(
    campaign: Campaign,
    why: Annotated[str, typer.Option(help="As: report signed by Ada, 2026-11-25.", show_default=False)],
    config: Config = None,
    data_dir: DataDir = None,
) -> None:
    """Never remove anything of a campaign, because a signed report or a decision rests on it."""
    with _retention(config, data_dir) as (store, _):
        held = store.hold(campaign, getpass.getuser(), why, shell_entry())
    typer.echo(f"campaign {held.campaign_id} is held by {held.by}: {held.why}")


def release(campaign: Campaign, config: Config = None, data_dir: DataDir = None) -> None:
    """Let the retention rule apply to a held campaign again."""
    with _retention(config, data_dir) as (store, _):
        store.release(campaign, shell_entry())
    typer.echo(f"campaign {campaign} is released: the retention rule applies to it")


def holds(config: Config = None, data_dir: DataDir = None) -> None:
    """Print one JSON line for each held campaign."""

    with _retention(config, data_dir) as (store, _):
        for one in store.holds():
            typer.echo(json.dumps(one.model_dump(mode="json")))


@contextmanager
def _retention(config: Path | None, data_dir: Path | None) -> Generator[tuple[RetentionStore, Settings]]:
    """Of the machine that the data folder belongs to. BadInput where it is nobody's."""
    from service.cli.database import opened, settings_of
    from service.store.files.data_folder import read_owner
    from service.store.retention import RetentionStore

    settings = settings_of(config, data_dir)
    owner = read_owner(settings.data_dir)
    if owner is None:
        raise BadInput(str(settings.data_dir), "belongs to no machine: start a service with this data folder first")
    with opened(config, data_dir) as database:
        yield RetentionStore(database, owner.machine), settings
