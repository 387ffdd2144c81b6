"""Results as files, and as JSON on stdout; options that several commands have. Nothing that a command computes with."""

from __future__ import annotations

import csv
import getpass
import io
import json
import re
import sys
from collections.abc import Generator, Iterable, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from service import writing

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table as RichTable

    from service.model.results.diagnosis import DataCheck, Diagnosis
    from service.model.results.estimate import Estimate
    from service.model.results.part import Part, Shown, Table
    from service.model.results.payload import Payload
    from service.store.people.audit import Entry
    from service.web.client import ServiceClient


def connect(url: str) -> ServiceClient:
    """The service at an address; close it after use."""
    from service.web.client import ServiceClient

    return ServiceClient(url)


def shell_entry() -> Entry:
    """Who is at the terminal, for the audit."""
    return {"actor": f"{getpass.getuser()} (shell)", "address": "shell"}


def put_json(document: Part, json_to: str | None) -> bool:
    """Write a result to a file (None: to none) or, for -, to stdout: True, and nothing else may be written there."""
    if json_to == "-":
        typer.echo(document.to_json())
    elif json_to is not None:
        write_file(Path(json_to), document.to_json())
    return json_to == "-"


def show(found: DataCheck | Diagnosis | Estimate | Payload, json_to: str | None) -> None:
    """Write a result as JSON where that is asked for, and print its tables unless stdout has the JSON."""
    if not put_json(found, json_to):
        print_result(found)


def write_file(path: Path, content: str | bytes) -> None:
    """Write a result where a person asked for it, text with an end of line; BadInput if that cannot be."""
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content if isinstance(content, bytes) else f"{content}\n".encode())


Item = TypeVar("Item")

_shown: ContextVar[bool] = ContextVar("shown", default=False)


@contextmanager
def waiting(for_what: str) -> Generator[None]:
    """While the block runs, a line shows the current work and the elapsed time; it is removed afterwards.

    In the block of another, the line of the other stays.
    """
    if _shown.get() or not sys.stderr.isatty():
        yield
        return
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(
        *columns,
        console=Console(stderr=True),
        transient=True,
        redirect_stdout=False,  # results go there
        redirect_stderr=False,
    ) as bars:
        bars.add_task(for_what, total=None)
        token = _shown.set(True)
        try:
            yield
        finally:
            _shown.reset(token)


def counted(items: Sequence[Item], of_what: str) -> Iterable[Item]:
    """The items; while they are gone through, a bar shows how many are done."""
    if not sys.stderr.isatty():
        return items
    from rich.console import Console
    from rich.progress import track

    return track(items, of_what, console=Console(stderr=True), transient=True)


def print_result(found: Shown, console: Console | None = None) -> None:
    """Its tables, fitted to the terminal, and its sentences. `console` None: stdout."""
    from rich.console import Console

    from service.model.results.part import Table

    console = console or Console()
    for part in found.shown():
        if isinstance(part, Table):
            console.print(_table(part))
        else:
            console.print(part, highlight=False, markup=False, soft_wrap=True)


def _table(table: Table) -> RichTable:
    from rich.table import Table as RichTable

    wide = any(len(text) > 60 for column in table.columns for text in column.texts)  # sentences, of several lines
    shown = RichTable(title=table.title, show_lines=wide)
    for column in table.columns:
        side = "right" if column.numeric else "left"
        shown.add_column(column.name, justify=side, overflow="fold", no_wrap=column.whole)
    for row in zip(*(column.texts for column in table.columns), strict=True):
        shown.add_row(*row)
    return shown


def write_report(form: str, path: Path, content: str | bytes) -> None:
    """Write a report in one of its forms: `html`, `pdf`, or the tables of its `json` into a folder."""
    write = write_tables if form == "json" else write_file
    write(path, content)


def write_tables(folder: Path, content: str | bytes) -> None:
    """`content`: the report's JSON form. BadInput if they cannot be written."""
    write_file(folder / "tables.json", content)
    for number, table in enumerate(json.loads(content)["tables"], start=1):
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows([table["head"], *table["rows"]])
        words = re.sub(r"[^a-z0-9]+", "-", table["section"].lower()).strip("-")
        write_file(folder / f"{number:02d}-{words[:60]}.csv", text.getvalue().rstrip("\n"))


DEFAULT_URL = "http://127.0.0.1:8642"
Url = Annotated[str, typer.Option(envvar="SWEEPID_URL", help="Address of the service.")]
JsonTo = Annotated[str | None, typer.Option("--json", help="Write JSON here; - is stdout.", metavar="FILE")]
Gains = Annotated[Path | None, typer.Option("--torque-gain", help="JSON file of `sweepid estimate torque-gain`.")]
BundleArg = Annotated[Path, typer.Argument(help="Directory of the bundle.", show_default=False)]

# what an export is made of
Source = Annotated[
    Path,
    typer.Argument(
        metavar="BUNDLE|ESTIMATE",
        help="Directory of a bundle, or file of `sweepid identify --json`.",
        show_default=False,
    ),
]
SideFile = Annotated[Path | None, typer.Option("--robot", help="Side file of the robot, for an ESTIMATE.")]

# what plans
RobotFile = Annotated[
    Path | None,
    typer.Argument(help="Side file of the robot, e.g. config/robots/max100-class.yaml; default: that of the machine."),
]
CellName = Annotated[str | None, typer.Option(help="Name of the cell around the robot; default: that of the machine.")]
ConfirmRobot = Annotated[
    str | None, typer.Option(help="Type the name of the robot, if it is another one than the machine's.")
]
ConfirmCell = Annotated[
    str | None, typer.Option(help="Type the name of the cell, if it is another one than the machine's.")
]

# what works on the data of the service
Config = Annotated[Path | None, typer.Option(help="Settings; default: config/service.yaml, if it exists.")]
DataDir = Annotated[Path | None, typer.Option(help="Database and recordings; default: that of the settings.")]
