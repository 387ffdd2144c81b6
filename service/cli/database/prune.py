"""`sweepid db prune`: the retention rule of the settings, and `hold`, `release`, `holds` for what has to stay."""

import getpass
import json
from collections.abc import Generator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from service.cli.backup import Config, DataDir, settings_of
from service.cli.people.open_database import opened, shell_entry
from service.errors import BadInput
from service.settings import Settings
from service.store.files.data_folder import read_owner
from service.store.objects.object_store import ObjectStore
from service.store.plant.pruning import Pruned, prune
from service.store.plant.retention import Doomed, RetentionStore, Rules

Campaign = Annotated[int, typer.Argument(metavar="CAMPAIGN", help="Its number.", min=1, show_default=False)]


def prune_command(
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only print what would be removed.")] = False,
    config: Config = None,
    data_dir: DataDir = None,
) -> None:
    """Remove samples, spectra and estimates of the data folder's machine that are older than the settings keep them.

    Settings: keep_samples_days, keep_spectra_days, keep_estimates_days. The service may run. stdout: a line a campaign.
    """
    with _store(config, data_dir) as (store, settings):
        rules = Rules(settings.keep_samples_days, settings.keep_spectra_days, settings.keep_estimates_days)
        if rules == Rules(None, None, None):
            raise BadInput(
                "settings", "keep everything: set `keep_samples_days`, `keep_spectra_days` or `keep_estimates_days`"
            )
        address = settings.recordings_store
        objects = None if address is None else ObjectStore(address)
        entry = None if dry_run else shell_entry()
        found = prune(store, settings.data_dir, objects, rules, datetime.now(UTC), entry, _print)
    _summary(found, dry_run)


def hold(
    campaign: Campaign,
    why: Annotated[str, typer.Option(help="As: report signed by Ada, 2026-11-25.", show_default=False)],
    config: Config = None,
    data_dir: DataDir = None,
) -> None:
    """Never remove anything of a campaign, because a signed report or a decision rests on it."""
    with _store(config, data_dir) as (store, _):
        held = store.hold(campaign, getpass.getuser(), why, shell_entry())
    typer.echo(f"campaign {held.campaign_id} is held by {held.by}: {held.why}")


def release(campaign: Campaign, config: Config = None, data_dir: DataDir = None) -> None:
    """Let the retention rule apply to a held campaign again."""
    with _store(config, data_dir) as (store, _):
        store.release(campaign, shell_entry())
    typer.echo(f"campaign {campaign} is released: the retention rule applies to it")


def holds(config: Config = None, data_dir: DataDir = None) -> None:
    """Print one JSON line for each held campaign."""
    with _store(config, data_dir) as (store, _):
        for one in store.holds():
            typer.echo(json.dumps(one.model_dump(mode="json")))


@contextmanager
def _store(config: Path | None, data_dir: Path | None) -> Generator[tuple[RetentionStore, Settings]]:
    """Of the machine that the data folder belongs to. BadInput where it is nobody's."""
    settings = settings_of(config, data_dir)
    owner = read_owner(settings.data_dir)
    if owner is None:
        raise BadInput(str(settings.data_dir), "belongs to no machine: start a service with this data folder first")
    with opened(config, data_dir) as database:
        yield RetentionStore(database, owner.machine), settings


def _print(one: Doomed) -> None:
    parts = f"{len(one.samples)} recordings, {len(one.spectra)} spectra, {len(one.estimates)} estimates"
    typer.echo(f"campaign {one.campaign_id}: {parts}")


def _summary(found: Pruned, dry_run: bool) -> None:
    for campaign, why in sorted(found.stay.items()):
        typer.echo(f"campaign {campaign} is kept: {why}", err=True)
    done = "would be removed" if dry_run else "removed"
    typer.echo(
        f"{done}: {found.recordings} recordings, {found.spectra} spectra, {found.estimates} estimates of "
        f"{found.campaigns} campaigns, {found.bytes} bytes"
    )
