"""`sweepid export-path PLAN`: the sweeps of a plan as tables and part programs for a CNC without fieldbus."""

from pathlib import Path
from typing import Annotated

import typer
from pydantic import BaseModel, ConfigDict, ValidationError

from service.configuration import bad_field, read_robot, read_text
from service.geometry.cell import read_cell
from service.paths.control import read_control
from service.paths.export import export_paths
from service.planning.plan import PlanDocument


class _PlanFile(BaseModel):
    """What `sweepid plan --out` writes; only the document matters here."""

    model_config = ConfigDict(frozen=True, extra="ignore")
    document: PlanDocument


def export_path(
    plan: Annotated[Path, typer.Argument(help="File that `sweepid plan --out` wrote.", show_default=False)],
    robot: Annotated[Path, typer.Option(help="Side file of the plan's robot.", show_default=False)],
    cell: Annotated[Path, typer.Option(help="File of the plan's cell.", show_default=False)],
    control: Annotated[Path, typer.Option(help="File of the CNC: axes, cycle, trace.", show_default=False)],
    out: Annotated[Path, typer.Option(help="Folder to write; must be empty or not exist.", show_default=False)],
) -> None:
    """Write every sweep of a plan as table (.csv) and Sinumerik part program (.MPF), and the mapping for the traces."""
    document = _read_plan(plan)
    known = read_robot(robot)
    count = export_paths(out, document, known, read_cell(cell), read_control(control, known))
    typer.echo(f"{out}: {count} sweep{'s' if count > 1 else ''} of {known.name}", err=True)


def _read_plan(path: Path) -> PlanDocument:
    text = read_text(path)
    try:
        return _PlanFile.model_validate_json(text).document
    except ValidationError as error:
        raise bad_field(str(path), error) from None
