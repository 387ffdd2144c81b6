"""`sweepid audit`: is it whole, and all of it as a file."""

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from service.cli.options import Config, DataDir


def verify_audit(
    head: Annotated[
        str | None,
        typer.Option(
            metavar="NUMBER:SHA256|FILE",
            help="Output of an earlier run, or a file with heads (or a log). Default: the file of the service.",
        ),
    ] = None,
    config: Config = None,
    data_dir: DataDir = None,
) -> None:
    """Does each entry fit the one before it, and are all known heads in the chain? Prints the head as NUMBER:SHA256, or
    the first entry that does not fit.
    """
    from service.cli.people.open_database import audit_heads_file, opened
    from service.store.access.audit_chain import heads_in, read_head, verify
    from service.store.people.audit import AuditStore

    file = Path(head) if head is not None else audit_heads_file(config, data_dir)
    if file.is_file():
        expected = heads_in(file.read_text("utf-8", errors="replace"), str(file))
    elif head is not None:
        expected = (read_head(head),)
    else:
        expected = ()
    with opened(config, data_dir) as database:
        number, value = verify(AuditStore(database).links(), expected)
    if not expected:
        sys.stderr.write(f"no head is known ({file} does not exist): an end that was cut off would not be noticed\n")
    sys.stdout.write(f"{number}:{value}\n")


def export_audit(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="JSON lines to write.")],
    config: Config = None,
    data_dir: DataDir = None,
) -> None:
    """Write all entries as JSON lines; `entry` is the text whose hash `sha256` goes over. Prints the file."""
    from service.cli.documents import write_file
    from service.cli.people.open_database import opened
    from service.store.people.audit import AuditStore

    with opened(config, data_dir) as database:
        lines = [
            json.dumps({"number": number, "entry": entry, "sha256": value})
            for number, entry, value in AuditStore(database).links()
        ]
    write_file(file, "\n".join(lines))
    sys.stdout.write(f"{file}\n")
