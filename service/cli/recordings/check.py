"""Findings of a data check in lines, for commands whose stdout is something else."""

from collections.abc import Sequence

import typer

from service.data_check import Finding


def warn(findings: Sequence[Finding]) -> None:
    """To stderr."""
    for line in as_lines(findings):
        typer.echo(line, err=True)


def as_lines(findings: Sequence[Finding]) -> list[str]:
    """One a finding."""
    return [f"{one.severity}: {one.sentence} {one.action}" for one in findings]
