"""The exported folder, and what is refused before anything is written."""

import csv
import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from service import BadInput
from service.formats.traces.mapping import CncAxis, Mapping
from service.identification.design.excitation import velocity_setpoint
from service.machine.paths.sweep_paths import (
    DECIMALS,
    CncControl,
    PathSweep,
    export_paths,
    part_program,
    path_sweeps,
    read_control,
    velocity_bound,
)
from service.model import Robot
from service.model.configuration import Cell, read_robot, read_yaml
from service.planning.documents import PlanDocument
from tests.unit.service.paths.conftest import CELL, CONTROL, ROBOT, ROOT
from tests.unit.service.paths.nc_walk import Walk, walk

DATA = {"IPO_CYCLE_TIME": 0.004, "INT_INCR_PER_DEG": 1_000_000.0}


@pytest.fixture(scope="session")
def sweeps(plan: PlanDocument, robot: Robot, cell: Cell, control: CncControl) -> list[PathSweep]:
    return list(path_sweeps(plan, robot, cell, control))


def program(sweep: PathSweep) -> str:
    return part_program(sweep, "max100-class", 1_000_000)


def test_the_written_positions_run_the_velocity_set_point(sweeps: list[PathSweep]) -> None:
    for sweep in sweeps:
        done = walk(program(sweep), sweep.start, DATA)
        assert done.feed == 60 / sweep.cycle
        steps = np.diff(np.array([sweep.position[0], *done.path]))
        speed = steps * done.feed / 60
        # blocks without way at the very ends are left out
        first = next(k for k in range(len(sweep.time)) if round(sweep.position[k + 1] - sweep.position[0], DECIMALS))
        middle = np.asarray((first + np.arange(len(speed)) + 0.5) * sweep.cycle, dtype=float)
        wanted = np.degrees(velocity_setpoint(sweep.excitation, middle))
        assert np.abs(speed - wanted).max() <= velocity_bound(sweep)
        assert velocity_bound(sweep) < 5e-4 * np.abs(sweep.velocity).max()
        on_path = np.interp(np.arange(first + 1, first + 1 + len(steps)) * sweep.cycle, sweep.time, sweep.position)
        assert np.abs(np.array(done.path) - on_path).max() <= 0.51 * 10.0**-DECIMALS < 1e-6
        assert abs(done.path[-1] - sweep.position[-1]) <= 0.51 * 10.0**-DECIMALS


def test_a_whole_plan_in_turn(sweeps: list[PathSweep], plan: PlanDocument) -> None:
    """Each program starts where the one before left the robot, and goes the plan's way in single-axis moves."""
    place = dict(sweeps[0].before)
    for sweep, planned in zip(sweeps, plan.sweeps, strict=True):
        done = walk(program(sweep), place, DATA)
        assert done.ended
        assert len(done.path) > 1000
        way = [(axis, target) for axis, target, stops in done.moves if stops == 1 and len(done.moves) > len(done.path)]
        if done.stops == 2:
            assert way == [(leg.axis, round(leg.target, DECIMALS)) for leg in sweep.legs]
        assert len(sweep.legs) == len(planned.legs)
        place = done.place


def test_nothing_moves_before_a_stop(sweeps: list[PathSweep]) -> None:
    for sweep in sweeps:
        for place in (sweep.before, sweep.start):
            done = walk(program(sweep), place, DATA)
            assert done.moves
            assert all(stops > 0 for _, _, stops in done.moves)
            path_stop = done.moves[-1][2]
            assert path_stop == done.stops  # the last stop stands right before the path


def elsewhere(sweep: PathSweep) -> dict[str, float]:
    return {axis: position + 0.2 for axis, position in sweep.start.items()}


@pytest.mark.parametrize(
    ("data", "offset", "message"),
    [
        ({"IPO_CYCLE_TIME": 0.002}, {}, "interpolation cycle is not 4 ms"),
        ({"INT_INCR_PER_DEG": 1000.0}, {}, "calculation resolution"),
        ({}, {"A4": 10.0}, "work position differs"),
        ({}, None, "neither at the pose"),
    ],
)
def test_another_control_and_a_robot_elsewhere_are_refused(
    sweeps: list[PathSweep], data: dict[str, float], offset: dict[str, float] | None, message: str
) -> None:
    place = elsewhere(sweeps[1]) if offset is None else sweeps[1].before
    done = walk(program(sweeps[1]), place, DATA | data, work_offset=offset)
    assert done.ended
    assert done.moves == []
    assert message in done.message


@pytest.mark.parametrize("stop", [1, 2])
def test_a_robot_jogged_away_at_a_stop_is_refused(sweeps: list[PathSweep], stop: int) -> None:
    sweep = next(sweep for sweep in sweeps if sweep.legs)

    def jog(machine: Walk) -> None:
        if machine.stops == stop:
            machine.place["A5"] += 3.0

    done = walk(program(sweep), sweep.before, DATA, at_stop=jog)
    assert done.path == []
    assert all(stops < stop for _, _, stops in done.moves)
    assert "neither at the pose" in done.message


def test_direction_and_zero_of_an_axis(plan: PlanDocument, robot: Robot, cell: Cell, control: CncControl) -> None:
    turned = control.model_copy(
        update={"axes": control.axes | {"joint_2": CncAxis(name="RB", direction=-1, zero=90.0)}}
    )
    sweep = list(path_sweeps(plan, robot, cell, turned))[1]
    assert sweep.axis == "RB"
    start = plan.sweeps[1].spec.pose[1]
    assert sweep.start["RB"] == pytest.approx(90 - np.degrees(start))
    assert np.sign(sweep.velocity.sum()) == -np.sign(plan.sweeps[1].spec.offset_velocity)
    np.testing.assert_allclose(np.diff(sweep.position).sum(), -np.degrees(sweep.excitation.travel), rtol=1e-9)


def test_an_axis_that_turns_back_is_refused(sweeps: list[PathSweep]) -> None:
    """Its speed is zero for a moment; a block without way would take no time and shorten the sweep."""
    position = sweeps[0].position.copy()
    position[600:602] = position[600]
    with pytest.raises(BadInput, match="A1 stands still within the sweep"):
        program(replace(sweeps[0], position=position))


def test_a_program_too_long_for_the_control_is_refused(sweeps: list[PathSweep]) -> None:
    with pytest.raises(BadInput, match=r"its program has \d+ bytes, the control takes 15000"):
        part_program(sweeps[0], "max100-class", 15_000)


def test_names_from_files_stay_inside_of_comments(sweeps: list[PathSweep]) -> None:
    planned = sweeps[0].planned
    named = planned.model_copy(update={"spec": planned.spec.model_copy(update={"id": "1\nG0 A1=90 ö"})})
    text = part_program(replace(sweeps[0], planned=named), "max\nM17", 1_000_000)
    assert "\nG0" not in text
    assert "\nM17" not in text
    assert text.isascii()


Export = Callable[..., int]


@pytest.fixture
def export(tmp_path: Path, plan: PlanDocument, robot: Robot, cell: Cell, control: CncControl) -> Export:
    """Into the folder `paths`, with another plan, cell or control where told."""

    def run(**other: Any) -> int:
        return export_paths(
            tmp_path / "paths", **{"plan": plan, "robot": robot, "cell": cell, "control": control} | other
        )

    return run


def changed(plan: PlanDocument, number: int, **changes: Any) -> PlanDocument:
    """The plan with other fields in one sweep; `spec_...` are fields of its spec."""
    sweep = plan.sweeps[number]
    spec = {name.removeprefix("spec_"): value for name, value in changes.items() if name.startswith("spec_")}
    own = {name: value for name, value in changes.items() if not name.startswith("spec_")}
    new = sweep.model_copy(update=own | {"spec": sweep.spec.model_copy(update=spec)})
    return plan.model_copy(update={"sweeps": (*plan.sweeps[:number], new, *plan.sweeps[number + 1 :])})


def test_the_folder(tmp_path: Path, plan: PlanDocument, robot: Robot, export: Export) -> None:
    count = export()
    assert count == len(plan.sweeps) == 9
    names = {path.name for path in (tmp_path / "paths").iterdir()}
    sweeps = {f"SWEEP_{number:04d}" for number in range(1, 10)}
    assert names == {f"{name}.{kind}" for name in sweeps for kind in ("MPF", "csv")} | {
        "mapping.yaml",
        "robot.yaml",
        "robot.urdf",
        "traces",
    }
    assert [path.name for path in tmp_path.iterdir()] == ["paths"]
    assert read_robot(tmp_path / "paths/robot.yaml").description.axes == robot.axes
    mapping = read_yaml(tmp_path / "paths/mapping.yaml", Mapping)
    for entry, planned in zip(mapping.sweeps, plan.sweeps, strict=True):
        assert (entry.axis, entry.pose, entry.sines) == (planned.spec.axis, planned.spec.pose, planned.spec.sines)
        assert entry.path is not None
        assert (entry.path.ramp, entry.path.settle) == (planned.ramp, planned.settle)


def test_the_table(tmp_path: Path, plan: PlanDocument, export: Export) -> None:
    export()
    with (tmp_path / "paths/SWEEP_0002.csv").open() as file:
        head, *rows = csv.reader(file)
    assert head == ["time [s]", *(f"A{k} [deg]" for k in range(1, 7)), "velocity of A2 [deg/s]"]
    table = np.array(rows, dtype=float)
    planned = plan.sweeps[1]
    np.testing.assert_allclose(np.diff(table[:, 0]), 0.004, atol=1e-9)
    np.testing.assert_allclose(table[0, 1:7], np.degrees(planned.spec.pose), atol=1e-9)
    assert np.ptp(np.delete(table[:, 1:7], 1, axis=1), axis=0).max() == 0
    assert table[0, 7] == table[-1, 7] == 0
    # trapezoids of the velocity are the position but for their own error, h^2 / 12 of the acceleration's change
    trapezoids = np.concatenate([[0.0], np.cumsum((table[1:, 7] + table[:-1, 7]) / 2) * 0.004])
    np.testing.assert_allclose(table[:, 2] - table[0, 2], trapezoids, atol=1e-4)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"spec_offset_velocity": 0.2}, "sweep 0002: joint_2: travel 0.8"),
        ({"velocity_limit": 0.5}, "sweep 0002: joint_2: velocity limit 0.5 rad/s is above the limit 0.1 rad/s"),
        ({"spec_pose": (0.0, 1.38, 0.0, 0.0, 0.0, 0.0)}, "sweep 0002: joint_2: distance from the planned pose"),
        ({"spec_sines": (), "spec_period": None, "spec_periods": None}, "sweep 0002: has no sines and periods"),
        ({"legs": ()}, "sweep 0002: joint_1: distance from the planned pose"),
        ({"spec_pose": (0.0,)}, "plan sweep 0002: pose has 1 numbers, robot max100-class has 6 axes"),
    ],
)
def test_a_sweep_that_cannot_be_run_is_not_written(
    changes: dict[str, Any], reason: str, tmp_path: Path, plan: PlanDocument, export: Export
) -> None:
    with pytest.raises(BadInput) as refusal:
        export(plan=changed(plan, 1, **changes))
    assert reason in str(refusal.value)
    assert list(tmp_path.iterdir()) == []


def test_a_plan_of_another_cell_and_a_cycle_too_slow_are_refused(
    cell: Cell, control: CncControl, export: Export
) -> None:
    with pytest.raises(BadInput, match="is for robot max100-class in cell workshop, not for max100-class in hall"):
        export(cell=cell.model_copy(update={"name": "hall"}))
    with pytest.raises(BadInput, match=r"sine of 5 Hz: a cycle of 0\.020001 s gives fewer than 10 steps"):
        export(control=control.model_copy(update={"interpolation_cycle": 0.020001}))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"axes": {"joint_1": {"name": "A1"}}}, "axes: must be the joints of max100-class: joint_1, joint_2"),
        ({"axes": {f"joint_{k}": {"name": "A1"} for k in range(1, 7)}}, "axes: an axis is listed twice"),
        ({"axes": {f"joint_{k}": {"name": f"A {k}"} for k in range(1, 7)}}, "axes.joint_1.name: String should match"),
        ({"interpolation_cycle": 0.1}, "interpolation_cycle: Input should be less than or equal to 0.02"),
    ],
)
def test_a_control_that_does_not_fit_is_refused(
    change: dict[str, Any], reason: str, tmp_path: Path, robot: Robot
) -> None:
    path = tmp_path / "control.yaml"
    path.write_text(yaml.safe_dump(yaml.safe_load(CONTROL.read_text()) | change))
    with pytest.raises(BadInput) as refusal:
        read_control(path, robot)
    assert reason in str(refusal.value)


def test_every_example_control_is_one() -> None:
    files = sorted((ROOT / "config/controls").glob("*.yaml"))
    assert files
    assert all(read_yaml(path, CncControl).axes for path in files)


def command(plan_file: Path, out: Path) -> list[str]:
    sweepid = str(Path(sys.executable).with_name("sweepid"))
    files = ["--robot", str(ROBOT), "--cell", str(CELL), "--control", str(CONTROL), "--out", str(out)]
    return [sweepid, "export", "path", str(plan_file), *files]


@pytest.mark.slow
def test_from_the_command_line(plan_file: Path, tmp_path: Path) -> None:
    done = subprocess.run(command(plan_file, tmp_path / "paths"), capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stdout) == (0, ""), done.stderr
    assert "9 sweeps of max100-class" in done.stderr
    again = subprocess.run(command(plan_file, tmp_path / "paths"), capture_output=True, text=True, timeout=300)
    assert (again.returncode, again.stdout) == (2, "")
    assert "exists already" in again.stderr
    plan_file.write_text(json.dumps({"id": 1}))
    bad = subprocess.run(command(plan_file, tmp_path / "more"), capture_output=True, text=True, timeout=300)
    assert (bad.returncode, bad.stderr) == (2, f"sweepid: {plan_file} document: Field required\n")
