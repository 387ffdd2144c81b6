"""`sweepid robot`: robots as their makers describe them."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service import BadInput, writing
from service.cli.terminal import write_file

if TYPE_CHECKING:
    from rich.console import Console

    from service.formats.maker_urdf import UrdfCheck, UrdfFinding


def check(
    urdf: Annotated[Path, typer.Argument(help="URDF or xacro file of the manufacturer.", show_default=False)],
    packages: Annotated[
        list[Path] | None, typer.Option(help="Folder of ROS packages, or one package; repeatable.")
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

    from service.formats.maker_urdf import bare_robot, cell_text, check_urdf, read_description
    from service.formats.maker_urdf.packages import Packages

    named = {key: Path(folder) for key, folder in (_pair(option, "=", "--package") for option in package or [])}
    given = dict(_pair(option, ":=", "--xacro-arg") for option in xacro_arg or [])
    where = Packages(packages or [], urdf.parent, named)
    checked = check_urdf(read_description(urdf, where, given), where, tip, str(urdf))
    called = name or checked.name
    findings = checked.findings
    drafts: dict[Path, str] = {}
    if not checked.lacking:
        cell, found = cell_text(bare_robot(checked), called)
        findings = (*findings, *found)
        if out is not None:
            with writing(out):
                drafts = drafts_of(checked, called, out, cell)
    print_findings(findings, checked, called, Console(stderr=out is not None))
    if out is not None and checked.lacking:
        raise checked.lacking[0]
    for path, text in drafts.items():
        write_file(path, text.rstrip("\n"))
        typer.echo(str(path))


def virtual(
    robot: Annotated[Path, typer.Argument(help="Side file of the robot; values may be open.", show_default=False)],
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for all files (usually NAME-virtual beside the folder of the side file)."),
    ] = None,
    eds: Annotated[Path, typer.Option(help="Object dictionary of the virtual drives.")] = Path(
        "config/eds/virtual-axis.eds"
    ),
) -> None:
    """Draft a virtual machine of a robot: files for `sweepid drive` and `sweepid serve`. Nothing is overwritten."""
    import os

    from service.formats.maker_urdf.virtual import DraftedRobot, virtual_machine
    from service.model.configuration import read_text, read_yaml

    if not eds.is_file():
        raise BadInput("--eds", f"there is no file {eds}; it is config/eds/virtual-axis.eds of sweepid's sources")
    drafted = read_yaml(robot, DraftedRobot)
    name = f"{drafted.name}-virtual"
    folder = robot.parent.parent / name if out is None else out
    relative = Path(os.path.relpath(eds.resolve(), folder.resolve() / "drives")).as_posix()
    texts = virtual_machine(drafted, read_text(robot.parent / drafted.urdf), folder.as_posix(), relative, str(robot))
    paths = {folder / path: text for path, text in texts.items()}
    refuse_existing(paths)
    for path, text in paths.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        write_file(path, text.rstrip("\n"))
        typer.echo(str(path))
    typer.echo(f"sweepid drive --scenario {folder / 'scenarios' / name}.yaml --eds {eds}", err=True)
    typer.echo(f"sweepid serve --config {folder / 'service.yaml'}", err=True)


def _pair(option: str, sign: str, name: str) -> tuple[str, str]:
    key, found, value = option.partition(sign)
    if not (key and found):
        raise BadInput(name, f"{option!r} is not NAME{sign}VALUE")
    return key, value


def drafts_of(checked: UrdfCheck, name: str, out: Path, cell: str) -> dict[Path, str]:
    """Texts by path; BadInput for a name that makes no file, and where a file is there already."""
    from service.formats.maker_urdf import side_file_text

    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]*", name):
        raise BadInput("--name", f"{name!r} is not a file name: use letters, digits, '-', '_' and '.'")
    drafts = {
        out / "robots" / f"{name}.urdf": checked.urdf_text,
        out / "robots" / f"{name}.yaml": side_file_text(checked, name, f"{name}.urdf"),
        out / "cells" / f"{name}.yaml": cell,
    }
    refuse_existing(drafts)
    return drafts


def refuse_existing(drafts: Iterable[Path]) -> None:
    """BadInput names the first file that is there already."""
    for path in drafts:
        if path.exists():
            raise BadInput(str(path), "exists already; nothing is overwritten")


def print_findings(findings: tuple[UrdfFinding, ...], checked: UrdfCheck, name: str, console: Console) -> None:
    """One row a finding."""
    from rich.table import Table

    joints = checked.chain.joints
    table = Table(title=f"{name}: {len(joints)} axes, {joints[0].name} to {joints[-1].name}")
    for column in ("", "where", "what"):
        table.add_column(column, overflow="fold")
    for kind in ("missing", "unusual", "changed"):
        for one in findings:
            if one.kind == kind:
                table.add_row(one.kind, one.place, one.sentence)
    console.print(table)
