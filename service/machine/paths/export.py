"""Writes the sweeps of a plan for a CNC: a folder of part programs, tables, and the mapping that reads the traces.

The folder is either complete or not there: it is written to a temporary folder next to it, which is then renamed.
"""

import csv
import shutil
from collections.abc import Sequence
from pathlib import Path
from uuid import uuid4

import yaml
from pydantic import BaseModel

from service.formats.traces.mapping import Mapping, SweepMotion, TraceSweep
from service.machine.paths.control import Control
from service.machine.paths.part_program import part_program
from service.machine.paths.sweep_paths import PathSweep, path_sweeps
from service.model.errors import BadInput
from service.model.geometry.cell import Cell
from service.model.robot import Robot
from service.planning.plan import PlanDocument


def export_paths(folder: Path, plan: PlanDocument, robot: Robot, cell: Cell, control: Control) -> int:
    """Write all sweeps of a plan to a new or empty folder; returns their number. BadInput, and nothing written, for the
    first sweep that leaves the envelope or does not fit into a part program.

    ``SWEEP_0001.MPF`` and ``.csv`` for every sweep; ``mapping.yaml`` with robot and URDF for `sweepid import trace`,
    which looks for the traces in ``traces/SWEEP_0001.csv`` and so on.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise BadInput(str(folder), "exists already and is not an empty folder")
    folder.parent.mkdir(parents=True, exist_ok=True)
    partial = folder.parent / f".{folder.name}.{uuid4().hex}.partial"
    partial.mkdir()
    try:
        sweeps: list[PathSweep] = []
        for sweep in path_sweeps(plan, robot, cell, control):
            program = part_program(sweep, robot.name, control.largest_program)
            (partial / f"{sweep.name}.MPF").write_text(program, encoding="ascii")
            _write_table(partial / f"{sweep.name}.csv", sweep)
            sweeps.append(sweep)
        _write_mapping(partial, robot, control, sweeps)
        (partial / "traces").mkdir()
        if folder.exists():
            folder.rmdir()
        partial.rename(folder)
    except BaseException:
        shutil.rmtree(partial, ignore_errors=True)
        raise
    return len(sweeps)


def _write_table(path: Path, sweep: PathSweep) -> None:
    """Time, position of every axis, velocity of the moving one; the column names contain the units."""
    head = [f"{axis} [{unit}]" for axis, unit in sweep.units.items()]
    with path.open("w", encoding="ascii", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["time [s]", *head, f"velocity of {sweep.axis} [{sweep.unit}/s]"])
        for time, position, velocity in zip(sweep.time, sweep.position, sweep.velocity, strict=True):
            pose = sweep.start | {sweep.axis: float(position)}
            table.writerow([f"{time:.6f}", *(f"{value:.9f}" for value in pose.values()), f"{velocity:.9f}"])


def _write_mapping(folder: Path, robot: Robot, control: Control, sweeps: Sequence[PathSweep]) -> None:
    (folder / "robot.urdf").write_text(robot.urdf_text, encoding="utf-8")
    _write_yaml(folder / "robot.yaml", robot.description.model_copy(update={"urdf": "robot.urdf"}))
    mapping = Mapping(
        robot=Path("robot.yaml"),
        axes=control.axes,
        columns=control.trace.columns,
        csv=control.trace.csv,
        sweeps=tuple(_trace_sweep(sweep, control.trace.sample_rate) for sweep in sweeps),
    )
    _write_yaml(folder / "mapping.yaml", mapping)


def _trace_sweep(sweep: PathSweep, sample_rate: float) -> TraceSweep:
    planned = sweep.planned
    spec = planned.spec.model_copy(update={"sample_rate": sample_rate})
    motion = SweepMotion(ramp=planned.ramp, settle=planned.settle)
    return TraceSweep(**spec.model_dump(), source=Path("traces") / f"{sweep.name}.csv", path=motion)


def _write_yaml(path: Path, content: BaseModel) -> None:
    document = content.model_dump(mode="json", exclude_unset=True)
    path.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
