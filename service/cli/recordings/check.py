"""Findings of a data check on the terminal."""

from collections.abc import Sequence

import typer
from rich.console import Console
from rich.table import Table

from service.data_check import Finding


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
