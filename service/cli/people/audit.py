"""`sweepid audit`: is it whole, and all of it as a file."""

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from service.cli.documents import write_file
from service.cli.people.open_database import Config, DataDir, opened
from service.people.audit_chain import read_head, verify
from service.store.people.audit import AuditStore

audit = typer.Typer(no_args_is_help=True, rich_markup_mode=None, help="Who asked the service for what.")


@audit.command("verify")
def verify_audit(
    head: Annotated[
        str | None, typer.Option(metavar="NUMBER:SHA256", help="Output of an earlier run that was stored elsewhere.")
    ] = None,
    config: Config = None,
    data_dir: DataDir = None,
) -> None:
    """Does each entry fit the one before it? Prints the head as NUMBER:SHA256, or the first that does not fit."""
    expected = None if head is None else read_head(head)
    with opened(config, data_dir) as database:
        number, value = verify(AuditStore(database).links(), expected)
    sys.stdout.write(f"{number}:{value}\n")


@audit.command("export")
def export_audit(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="JSON lines to write.")],
    config: Config = None,
    data_dir: DataDir = None,
) -> None:
    """Write all entries as JSON lines; `entry` is the text whose hash `sha256` goes over. Prints the file."""
    with opened(config, data_dir) as database:
        lines = [
            json.dumps({"number": number, "entry": entry, "sha256": value})
            for number, entry, value in AuditStore(database).links()
        ]
    write_file(file, "\n".join(lines))
    sys.stdout.write(f"{file}\n")
