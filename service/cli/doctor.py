"""`sweepid doctor`: what is wrong with the data folder. Read only."""

import typer

from service.backup.examination import examine
from service.backup.examined import examined
from service.cli.backup import Config, DataDir, settings_of
from service.cli.progress_indicator import waiting


def doctor(config: Config = None, data_dir: DataDir = None) -> None:
    """Read the database and every file that it names; print a line a finding, with what to do. Exit code 1 if any.

    Recordings that are in an object store are read there. Nothing is changed; the service may run.
    """
    settings = settings_of(config, data_dir)
    database = examined(settings.url, settings.database_password_file)
    with waiting("the examination"):
        findings = examine(database, settings.data_dir, settings.least_free_disk, settings.recordings_store)
    for finding in findings:
        typer.echo(finding.line)
    raise typer.Exit(code=min(len(findings), 1))
