"""Where no fieldbus reaches: paths out, the CNC's traces back in, and the inertia that the fieldbus gives."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from service import BadInput
from service.formats.traces.trace_import import import_trace
from service.identification.estimates.estimate import identify
from service.identification.spectra.frequency_response import spectrum
from service.machine.paths.sweep_paths import export_paths, read_control
from service.model import Recording, Robot, Sweep
from service.model.configuration import read_cell, read_robot
from service.planning.documents import PlanDocument, PlannedSweep, PlanRequest
from service.planning.plan import build_plan
from service.store.files.bundle import write_bundle
from simulator import load_scenario
from tests.cnc_trace import Array, cnc_columns, simulate, write_trace

CONFIG = Path(__file__).parents[2] / "config"
TRIGGERS = (713, 402, 998, 551, 640, 877)  # ms before the motion; not whole samples of 4 ms


@dataclasses.dataclass(frozen=True)
class Measured:
    """The sweeps of a plan at a virtual machine, and the folder they were exported to."""

    robot: Robot
    plan: PlanDocument
    columns: list[dict[str, Array]]
    folder: Path

    @property
    def planned(self) -> list[PlannedSweep]:
        return list(self.plan.sweeps)

    def trace(self, number: int) -> dict[str, Array]:
        return cnc_columns(self.planned[number], self.robot, self.columns[number], TRIGGERS[number])

    def trace_file(self, number: int) -> Path:
        return self.folder / f"traces/SWEEP_{number + 1:04d}.csv"


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Measured:
    robot, cell = read_robot(CONFIG / "robots/max100-class.yaml"), read_cell(CONFIG / "cells/workshop.yaml")
    request = PlanRequest(
        robot_id=1, cell=cell.name, axes=("joint_1", "joint_3"), varied=("joint_2", "joint_3"), step=30, poses=3
    )
    plan = build_plan(robot, request, cell)
    folder = tmp_path_factory.mktemp("cnc") / "paths"
    export_paths(folder, plan, robot, cell, read_control(CONFIG / "controls/sinumerik.yaml", robot))
    columns = simulate(load_scenario(CONFIG / "scenarios/max100-full.yaml"), list(plan.sweeps), seed=8)
    measured = Measured(robot, plan, columns, folder)
    for number in range(len(columns)):
        write_trace(measured.trace_file(number), measured.trace(number))
    return measured


def fieldbus(measured: Measured) -> list[Sweep]:
    """The same sweeps as a drive's 250 Hz samples; without the direct encoder, as the traces."""
    sweeps: list[Sweep] = []
    for planned, columns in zip(measured.planned, measured.columns, strict=True):
        count = len(columns["time"]) // 4
        motor = {name: values for name, values in columns.items() if not name.startswith("load")}
        samples = {name: values[: 4 * count].reshape(-1, 4).mean(axis=1) for name, values in motor.items()}
        sweeps.append(Sweep(planned.spec, Recording(**samples | {"time": np.arange(count) / 250})))
    return sweeps


def test_traces_give_the_inertia_of_the_fieldbus(measured: Measured, tmp_path: Path) -> None:
    robot, sweeps = import_trace(measured.folder / "mapping.yaml")
    write_bundle(tmp_path / "bundle", robot, sweeps)  # which checks all that a bundle must be
    for sweep, planned, trigger in zip(sweeps, measured.planned, TRIGGERS, strict=True):
        # a sample is the mean over 4 ms and its time their beginning
        assert abs(sweep.spec.measure_from - planned.ramp - planned.settle - (trigger - 2) / 1000) < 5e-6
    there, here = (
        [one for axis in identify(robot, [spectrum(robot, sweep) for sweep in way]).axes for one in axis.sweeps]
        for way in (fieldbus(measured), sweeps)
    )
    for bus, trace in zip(there, here, strict=True):
        print(f"{bus.value:.2f} +- {bus.std:.2f} by bus, {trace.value:.2f} +- {trace.std:.2f} by trace")
        assert abs(trace.value - bus.value) < 0.3 * bus.std
        assert trace.std == pytest.approx(bus.std, rel=0.1)


def test_the_torque_of_another_axis_unit_or_sign_shows(measured: Measured) -> None:
    columns = measured.trace(0)
    write_trace(measured.trace_file(0), columns | {"CMD_SPEED": -columns["CMD_SPEED"]})
    try:
        with pytest.raises(BadInput, match="sweep 0001: velocity_setpoint moves -1 times as far as the path"):
            import_trace(measured.folder / "mapping.yaml")
    finally:
        write_trace(measured.trace_file(0), columns)
