"""`sweepid robot`: robots as their makers describe them."""

from pathlib import Path
from typing import Annotated

import typer


def check(
    urdf: Annotated[Path, typer.Argument(help="URDF or xacro file of the manufacturer.", show_default=False)],
    packages: Annotated[
        list[Path] | None,
        typer.Option(help="Folder of ROS packages, or one package; repeatable."),
    ] = None,
    package: Annotated[list[str] | None, typer.Option(help="NAME=FOLDER of one package; repeatable.")] = None,
    xacro_arg: Annotated[
        list[str] | None, typer.Option(help="NAME:=VALUE of an argument of the xacro file; repeatable.")
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
    from service.maker_urdf import cell_text, check_urdf, read_description
    from service.maker_urdf.packages import Packages

    named = {key: Path(folder) for key, folder in (_pair(option, "=", "--package") for option in package or [])}
    given = dict(_pair(option, ":=", "--xacro-arg") for option in xacro_arg or [])
    where = Packages(packages or [], urdf.parent, named)
    checked = check_urdf(read_description(urdf, where, given), where, tip, str(urdf))
    called = name or checked.name
    findings = checked.findings
    drafts: dict[Path, str] = {}
    if not checked.lacking:
        cell, found = cell_text(checked, called)
        findings = (*findings, *found)
        if out is not None:
            drafts = drafts_of(checked, called, out, cell)
    print_findings(findings, checked, called, Console(stderr=out is not None))
    if out is not None and checked.lacking:
        raise checked.lacking[0]
    for path, text in drafts.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        write_file(path, text.rstrip("\n"))
        typer.echo(str(path))


def _pair(option: str, sign: str, name: str) -> tuple[str, str]:
    from service.errors import BadInput

    key, found, value = option.partition(sign)
    if not (key and found):
        raise BadInput(name, f"{option!r} is not NAME{sign}VALUE")
    return key, value
