"""`sweepid check BUNDLE`: is the data fit for physics? What a person may read, and what a program may."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from service.cli.documents import JsonTo, put_json
from service.cli.progress_indicator import waiting
from service.data_check import Finding, findings_document
from service.data_check import check as check_data
from service.results.check import DataCheck
from service.store.files.bundle import read_bundle


def check(
    bundle: Annotated[Path, typer.Argument(help="Directory of the bundle.", show_default=False)],
    json_to: JsonTo = None,
) -> None:
    """Tell what is wrong with recordings and robot file, before any physics."""
    with waiting("checking the data"):
        measured = read_bundle(bundle)
        findings = check_data(measured.robot, measured.sweeps)
    document = findings_document(measured.robot, measured.sweeps, findings)
    if put_json(DataCheck.read(document, str(bundle)), json_to):
        return
    print_findings(findings, len(measured.sweeps), Console())


def print_findings(findings: Sequence[Finding], sweeps: int, console: Console) -> None:
    """One row a finding; what was found and what to do."""
    if not findings:
        console.print(f"Nothing found in {sweeps} sweep{'s' * (sweeps > 1)}.")
        return
    table = Table(title=f"Check of {sweeps} sweep{'s' * (sweeps > 1)}", show_lines=True)
    for name in ("", "what", "found", "to do"):
        table.add_column(name, overflow="fold")
    for one in findings:
        table.add_row(one.severity, one.code, one.sentence, one.action)
    console.print(table)


def warn(findings: Sequence[Finding]) -> None:
    """The same in lines on stderr, for commands whose stdout is something else."""
    for line in as_lines(findings):
        typer.echo(line, err=True)


def as_lines(findings: Sequence[Finding]) -> list[str]:
    """One a finding."""
    return [f"{one.severity}: {one.sentence} {one.action}" for one in findings]
