"""The sweeps of a plan for the CNC: start, legs to it, and positions of each.

Before anything is written, the envelope of the plan (joint limits, speed, effort, room in the cell) is checked for each
sweep and for each leg between two sweeps, starting from the cell's home.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from service.formats.traces.mapping import CncAxis, Columns, Csv
from service.identification.design.excitation import Excitation, velocity_setpoint, way
from service.model.arrays import Array
from service.model.configuration import Cell, read_yaml
from service.model.errors import BadInput, EnvelopeViolation
from service.model.robot import Robot
from service.planning.documents import PlanDocument, PlannedSweep
from service.planning.safety.envelope import Envelope
from service.store.files.bundle import check_specs


class CncTrace(BaseModel):
    """How the CNC exports its trace."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    sample_rate: float = Field(gt=0)  # Hz
    csv: Csv = Csv()
    columns: Columns


class CncControl(BaseModel):
    """One CNC. `axes` by joint; all joints of the robot are required."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    name: str = Field(min_length=1)
    axes: dict[str, CncAxis]
    interpolation_cycle: float = Field(default=0.004, ge=0.0005, le=0.02)  # s
    largest_program: int = Field(default=1_000_000, ge=10_000)  # bytes
    trace: CncTrace


def read_control(path: Path, robot: Robot) -> CncControl:
    """The control of a robot; BadInput unless it names each joint once, each with a different axis."""
    control = read_yaml(path, CncControl)
    if set(control.axes) != set(robot.joints):
        raise BadInput(f"{path} axes", f"must be the joints of {robot.name}: {', '.join(robot.joints)}")
    names = [axis.name.upper() for axis in control.axes.values()]
    if len(set(names)) < len(names):
        raise BadInput(f"{path} axes", f"an axis is listed twice: {', '.join(names)}")
    if control.trace.columns.set_position is None:
        raise BadInput(f"{path} trace.columns", "set_position is missing: it tells where a trace's motion starts")
    return control


@dataclass(frozen=True)
class Leg:
    """A positioning move of one axis, in the CNC's units."""

    axis: str
    target: float  # deg (mm)
    speed: float  # deg/min (mm/min)


@dataclass(frozen=True)
class PathSweep:
    """One sweep in the CNC's units: deg and deg/s, of a linear axis mm and mm/s."""

    number: int  # 1, 2, ... in the order of the plan
    planned: PlannedSweep
    excitation: Excitation
    cycle: float  # s
    axis: str  # the moving axis
    units: dict[str, str]  # "deg" or "mm" by axis
    before: dict[str, float]  # position of every axis before the legs
    legs: tuple[Leg, ...]
    start: dict[str, float]  # position of every axis at the start of the sweep
    time: Array  # (n,) s, whole cycles from 0 on
    position: Array  # (n,) of the moving axis
    velocity: Array  # (n,)

    @property
    def unit(self) -> str:
        """Unit of the moving axis' position."""
        return self.units[self.axis]

    @property
    def name(self) -> str:
        """Name of the program and the files; two letters first and at most 24 characters, as required for NC names."""
        return f"SWEEP_{self.number:04d}"


def path_sweeps(plan: PlanDocument, robot: Robot, cell: Cell, control: CncControl) -> Iterator[PathSweep]:
    """The sweeps of a plan, one at a time; BadInput names the first that is not permitted."""
    if (plan.robot, plan.request.cell) != (robot.name, cell.name):
        raise BadInput(
            "plan", f"is for robot {plan.robot} in cell {plan.request.cell}, not for {robot.name} in {cell.name}"
        )
    check_specs(robot, [sweep.spec for sweep in plan.sweeps], "plan")
    envelope = Envelope(robot, cell)
    here = list(cell.home_pose(robot.joints))
    for number, planned in enumerate(plan.sweeps, start=1):
        place = f"sweep {planned.spec.id}"
        _check_sampling(planned, control, place)
        try:
            before = tuple(here)
            for leg in planned.legs:
                envelope.check_move(leg.joint, here, leg.target, plan.request.move_velocity)
                here[robot.index(leg.joint)] = leg.target
            envelope.check_standing(planned.spec.pose, here, 1e-3)  # rad (m): nearer axes need no leg
            envelope.check_sweep(planned.command(), planned.spec.pose)
        except EnvelopeViolation as error:
            raise BadInput(place, str(error)) from None
        sweep = _in_cnc_units(number, planned, robot, control, before, plan.request.move_velocity)
        here = list(planned.spec.pose)
        here[robot.index(planned.spec.axis)] += sweep.excitation.travel
        yield sweep


def _check_sampling(planned: PlannedSweep, control: CncControl, place: str) -> None:
    if not planned.spec.periodic:
        raise BadInput(place, "has no sines and periods: it has no path")
    fastest = max(sine.frequency for sine in planned.spec.sines)
    least = 10  # steps of a period: with fewer, a table of positions does not represent the sine
    if fastest * control.interpolation_cycle * least > 1:
        raise BadInput(
            place,
            f"sine of {fastest:.6g} Hz: a cycle of {control.interpolation_cycle} s gives fewer than "
            f"{least} steps per period",
        )


def _in_cnc_units(
    number: int, planned: PlannedSweep, robot: Robot, control: CncControl, before: tuple[float, ...], speed: float
) -> PathSweep:
    command, pose = planned.command(), planned.spec.pose
    path = Excitation(
        command.offset_velocity, planned.spec.sines, command.period, command.periods, command.ramp, command.settle
    )
    prismatic = [joint.kind == "prismatic" for joint in robot.chain.joints]
    scales = [1e3 if one else math.degrees(1.0) for one in prismatic]
    axes = [control.axes[joint] for joint in robot.joints]
    moving = robot.index(planned.spec.axis)

    def shown(index: int, position: float) -> float:
        return axes[index].zero + axes[index].direction * scales[index] * position

    cycles = math.ceil(path.duration / control.interpolation_cycle - 1e-9)
    time = np.linspace(0.0, cycles * control.interpolation_cycle, cycles + 1)
    signed = axes[moving].direction * scales[moving]
    return PathSweep(
        number=number,
        planned=planned,
        excitation=path,
        cycle=control.interpolation_cycle,
        axis=axes[moving].name,
        units={axis.name: "mm" if one else "deg" for axis, one in zip(axes, prismatic, strict=True)},
        before={axis.name: shown(k, before[k]) for k, axis in enumerate(axes)},
        legs=tuple(
            Leg(axes[k].name, shown(k, leg.target), 60 * speed * scales[k])
            for leg in planned.legs
            for k in [robot.index(leg.joint)]
        ),
        start={axis.name: shown(k, pose[k]) for k, axis in enumerate(axes)},
        time=time,
        position=shown(moving, pose[moving]) + signed * way(path, time),
        velocity=signed * velocity_setpoint(path, time),
    )
