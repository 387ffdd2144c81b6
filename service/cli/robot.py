"""`sweepid robot check URDF`: from a maker's URDF to files that the service plans with."""

import re
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from service.cli.documents import write_file
from service.configuration import read_text
from service.errors import BadInput
from service.maker_urdf import Finding, UrdfCheck, cell_text, check_urdf, side_file_text
from service.maker_urdf.packages import Packages

robot = typer.Typer(no_args_is_help=True, rich_markup_mode=None, help="Robots as their makers describe them.")


@robot.callback()
def _group() -> None:
    """Robots as their makers describe them."""


@robot.command()
def check(
    urdf: Annotated[Path, typer.Argument(help="URDF of the maker (a xacro file expanded).", show_default=False)],
    packages: Annotated[
        list[Path] | None,
        typer.Option(help="Folder of mesh packages, or one package; repeatable."),
    ] = None,
    tip: Annotated[str | None, typer.Option(help="Last link of the axes to measure, where there are several.")] = None,
    name: Annotated[str | None, typer.Option(help="Name of the robot (usually the URDF's).")] = None,
    out: Annotated[
        Path | None, typer.Option(help="Draft robots/NAME.urdf, robots/NAME.yaml, cells/NAME.yaml in this folder.")
    ] = None,
) -> None:
    """Tell what of a URDF is unusual and what is missing, and draft the files of the robot. Nothing is overwritten."""
    checked = check_urdf(read_text(urdf), Packages(packages or [], urdf.parent), tip, str(urdf))
    called = name or checked.name
    findings = checked.findings
    drafts: dict[Path, str] = {}
    if not checked.unread:
        cell, found = cell_text(checked, called)
        findings = (*findings, *found)
        if out is not None:
            drafts = _drafts(checked, called, out, cell)
    _print(findings, checked, called, Console(stderr=out is not None))
    if out is not None and checked.unread:
        raise checked.unread[0]
    for path, text in drafts.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        write_file(path, text.rstrip("\n"))
        typer.echo(str(path))


def _drafts(checked: UrdfCheck, name: str, out: Path, cell: str) -> dict[Path, str]:
    """Texts by path; BadInput for a name that makes no file, and where a file is there already."""
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]*", name):
        raise BadInput("--name", f"{name!r} is not a file name: use letters, digits, '-', '_' and '.'")
    drafts = {
        out / "robots" / f"{name}.urdf": checked.urdf_text,
        out / "robots" / f"{name}.yaml": side_file_text(checked, name, f"{name}.urdf"),
        out / "cells" / f"{name}.yaml": cell,
    }
    for path in drafts:
        if path.exists():
            raise BadInput(str(path), "exists already; nothing is overwritten")
    return drafts


def _print(findings: tuple[Finding, ...], checked: UrdfCheck, name: str, console: Console) -> None:
    """One row a finding."""
    joints = checked.chain.joints
    table = Table(title=f"{name}: {len(joints)} axes, {joints[0].name} to {joints[-1].name}")
    for column in ("", "where", "what"):
        table.add_column(column, overflow="fold")
    for kind in ("missing", "unusual", "changed"):
        for one in findings:
            if one.kind == kind:
                table.add_row(one.kind, one.place, one.sentence)
    console.print(table)
