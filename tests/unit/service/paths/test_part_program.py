"""The part programs: the path they run, and that they stand still wherever something is not as the plan has it."""

from dataclasses import replace

import numpy as np
import pytest

from service.formats.traces.mapping import CncAxis
from service.identification.design.excitation import velocity_setpoint
from service.machine.paths.export import DECIMALS, part_program, velocity_bound
from service.machine.paths.sweep_paths import CncControl, PathSweep, path_sweeps
from service.model.errors import BadInput
from service.model.geometry.cell import Cell
from service.model.robot import Robot
from service.planning.documents import PlanDocument
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
    ],
)
def test_another_control_is_refused(
    sweeps: list[PathSweep], data: dict[str, float], offset: dict[str, float], message: str
) -> None:
    done = walk(program(sweeps[1]), sweeps[1].before, DATA | data, work_offset=offset)
    assert done.ended
    assert done.moves == []
    assert message in done.message


def test_a_robot_elsewhere_is_refused(sweeps: list[PathSweep]) -> None:
    done = walk(program(sweeps[1]), elsewhere(sweeps[1]), DATA)
    assert (done.moves, done.ended) == ([], True)
    assert "neither at the pose" in done.message


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
