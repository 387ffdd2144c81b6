"""`sweepid doctor`: what is wrong with the data folder. Read only."""

import typer

from service.backup.examination import examine
from service.cli.backup import Config, DataDir, settings_of
from service.cli.waiting import waiting
from service.store.snapshot import sqlite_file


def doctor(config: Config = None, data_dir: DataDir = None) -> None:
    """Read the database and every file that it names; print a line a finding, with what to do. Exit code 1 if any.

    Nothing is changed; the service may run.
    """
    settings = settings_of(config, data_dir)
    with waiting("the examination"):
        findings = examine(sqlite_file(settings.url), settings.data_dir, settings.least_free_disk)
    for finding in findings:
        typer.echo(finding.line)
    raise typer.Exit(code=min(len(findings), 1))
