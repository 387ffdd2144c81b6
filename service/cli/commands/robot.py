"""`sweepid robot`: robots as their makers describe them."""

from pathlib import Path
from typing import Annotated

import typer


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
    from rich.console import Console

    from service.cli.documents import write_file
    from service.cli.urdf_findings import drafts_of, print_findings
    from service.configuration import read_text
    from service.errors import writing
    from service.maker_urdf import cell_text, check_urdf
    from service.maker_urdf.packages import Packages

    checked = check_urdf(read_text(urdf), Packages(packages or [], urdf.parent), tip, str(urdf))
    called = name or checked.name
    findings = checked.findings
    drafts: dict[Path, str] = {}
    if not checked.unread:
        cell, found = cell_text(checked, called)
        findings = (*findings, *found)
        if out is not None:
            with writing(out):
                drafts = drafts_of(checked, called, out, cell)
    print_findings(findings, checked, called, Console(stderr=out is not None))
    if out is not None and checked.unread:
        raise checked.unread[0]
    for path, text in drafts.items():
        write_file(path, text.rstrip("\n"))
        typer.echo(str(path))
