"""`sweepid db copy`: all that one database holds into another, as from SQLite to PostgreSQL."""

from pathlib import Path
from typing import Annotated

import typer

from service.cli.database.prune import hold, holds, prune_command, release
from service.cli.progress_indicator import waiting
from service.errors import BadInput
from service.settings import Settings
from service.store.copying.copy import copy_rows
from service.store.database import open_database
from service.store.engines.address import parsed_url

db = typer.Typer(no_args_is_help=True, rich_markup_mode=None, help="The database as a whole.")

Url = "sqlite:///PATH or postgresql+psycopg://USER@HOST/NAME, without a password"


@db.callback()
def group() -> None:
    """The database as a whole."""


db.command("prune")(prune_command)
db.command("hold")(hold)
db.command("release")(release)
db.command("holds")(holds)


@db.command()
def copy(
    source: Annotated[str, typer.Option("--from", help=f"URL to copy from: {Url}.", show_default=False)],
    target: Annotated[str, typer.Option("--to", help="URL of an empty database to copy to.", show_default=False)],
    from_password_file: Annotated[Path | None, typer.Option(help="Password of --from; default: PGPASSFILE.")] = None,
    to_password_file: Annotated[Path | None, typer.Option(help="Password of --to; default: PGPASSFILE.")] = None,
) -> None:
    """Copy every row, then compare counts and a hash of every row. The service must not run. All or nothing.

    A source of an older schema is migrated first, as by a start of the service. stdout: how many rows.
    """
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
