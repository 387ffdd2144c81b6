"""What was found in a maker's URDF, on the terminal and as drafts of files."""

import re
from collections.abc import Iterable
from pathlib import Path

from rich.console import Console
from rich.table import Table

from service.formats.maker_urdf import UrdfCheck, UrdfFinding, side_file_text
from service.model.errors import BadInput


def drafts_of(checked: UrdfCheck, name: str, out: Path, cell: str) -> dict[Path, str]:
    """Texts by path; BadInput for a name that makes no file, and where a file is there already."""
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
    joints = checked.chain.joints
    table = Table(title=f"{name}: {len(joints)} axes, {joints[0].name} to {joints[-1].name}")
    for column in ("", "where", "what"):
        table.add_column(column, overflow="fold")
    for kind in ("missing", "unusual", "changed"):
        for one in findings:
            if one.kind == kind:
                table.add_row(one.kind, one.place, one.sentence)
    console.print(table)
