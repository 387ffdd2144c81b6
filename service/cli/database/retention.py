"""The retention rule of the settings, applied to the data folder of a machine."""

from collections.abc import Generator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

import typer

from service.cli.people.open_database import opened, shell_entry
from service.cli.settings_of import settings_of
from service.model.errors import BadInput
from service.process.settings import Settings
from service.store.files.data_folder import read_owner
from service.store.objects import ObjectStore
from service.store.retention import Doomed, Pruned, RetentionRules, RetentionStore, prune


def prune_data(config: Path | None, data_dir: Path | None, dry_run: bool) -> None:
    """Remove what is older than the settings keep it; a line a campaign."""
    with retention(config, data_dir) as (store, settings):
        rules = RetentionRules(settings.keep_samples_days, settings.keep_spectra_days, settings.keep_estimates_days)
        if rules == RetentionRules(None, None, None):
            raise BadInput(
                "settings", "keep everything: set `keep_samples_days`, `keep_spectra_days` or `keep_estimates_days`"
            )
        address = settings.recordings_store
        objects = None if address is None else ObjectStore(address)
        entry = None if dry_run else shell_entry()
        found = prune(store, settings.data_dir, objects, rules, datetime.now(UTC), entry, _print)
    _summary(found, dry_run)


@contextmanager
def retention(config: Path | None, data_dir: Path | None) -> Generator[tuple[RetentionStore, Settings]]:
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
