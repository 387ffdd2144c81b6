"""The sweeps of a plan for the CNC: start, legs to it, and positions of each.

Before anything is written, the envelope of the plan (joint limits, speed, effort, room in the cell) is checked for each
sweep and for each leg between two sweeps, starting from the cell's home.

Writes the sweeps of a plan for a CNC: a folder of part programs, tables, and the mapping that reads the traces.

A part program is for a Sinumerik 840D sl (docs/explanation/decisions/0007-paths-in-inverse-time.md). Each block moves
the axis to the next position of the path in the same time: G93, inverse-time feed, F in 1/min, modal like G93 itself
(Programming Manual NC Programming, "Feedrate (G93, G94, G95, F, FGROUP)"). The difference of a block's mean speed from
the set-point is at most `velocity_bound`.

The program stops if the control or the pose differs from the plan. It stops before each motion, and checks the position
of the robot after each stop. Each branch ends at standstill. It has no block numbers; blocks are far below the limit of
512 characters of the control.
"""

import csv
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field

from service import BadInput, EnvelopeViolation
from service.formats.traces.mapping import CncAxis, Columns, Csv, Mapping, SweepTimes, TraceSweep
from service.identification.design.excitation import Excitation, peak_jerk, velocity_setpoint, way
from service.model import Array, Robot
from service.model.configuration import Cell, read_yaml
from service.planning.documents import PlanDocument, PlannedSweep
from service.planning.safety.envelope_check import Envelope
from service.store.files.bundle import check_specs
from service.store.files.recordings import new_folder


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


DECIMALS = 7  # places of a position
RESOLUTION = 100_000  # increments per deg (mm) that the control must calculate with


def velocity_bound(sweep: PathSweep) -> float:
    """Largest difference between the mean speed of a block and the set-point in its middle, deg/s (mm/s).

    T^2 / 24 of the set-point's second derivative, and half a last decimal at either end.
    """
    scale = 1e3 if sweep.unit == "mm" else math.degrees(1.0)
    return scale * peak_jerk(sweep.excitation) * sweep.cycle**2 / 24 + 10.0**-DECIMALS / sweep.cycle


def part_program(sweep: PathSweep, robot: str, largest: int) -> str:
    """The text of the program; BadInput if the axis stands still in the sweep or the text exceeds `largest` bytes."""
    positions = _moving_blocks(sweep)
    refusals = {
        "BAD_CYCLE": f"interpolation cycle is not {1e3 * sweep.cycle:g} ms",
        "BAD_RESOLUTION": f"calculation resolution is below {RESOLUTION} increments",
        "BAD_FRAME": "work position differs from machine position",
        "ELSEWHERE": "robot stands neither at the pose nor where the way to it begins",
    }
    lines = [
        *_header(sweep, robot, len(positions)),
        *_checks(sweep),
        *_way(sweep),
        *_motion(sweep, positions),
        *(line for label, reason in refusals.items() for line in _refusal(sweep, label, reason)),
    ]
    text = "\n".join(lines) + "\n"
    if len(text) > largest:
        raise BadInput(
            f"sweep {sweep.planned.spec.id}", f"its program has {len(text)} bytes, the control takes {largest}"
        )
    return text


def _moving_blocks(sweep: PathSweep) -> list[str]:
    """Positions as written. In G93 a block without motion takes no time, therefore there is none."""
    texts = [_number(position) for position in sweep.position]
    moves = [k for k in range(1, len(texts)) if texts[k] != texts[k - 1]]
    first, last = moves[0], moves[-1]
    if len(moves) < last - first + 1:
        raise BadInput(
            f"sweep {sweep.planned.spec.id}",
            f"{sweep.axis} stands still within the sweep: a part program cannot time a block without way",
        )
    return texts[first : last + 1]


def _header(sweep: PathSweep, robot: str, blocks: int) -> list[str]:
    spec, unit = sweep.planned.spec, sweep.unit
    pose = ", ".join(f"{axis} {value:.4f} {sweep.units[axis]}" for axis, value in sweep.start.items())
    lines = ", ".join(f"{sine.frequency:g}" for sine in spec.sines)
    texts = [
        f"{sweep.name}: one axis turns slowly, offset and sines; the robot's inertia follows from torque and speed",
        f"robot {robot}, sweep {spec.id} of the plan, axis {sweep.axis} ({spec.axis})",
        f"pose: {pose}",
        f"travel: {sweep.axis} from {sweep.position[0]:.4f} to {sweep.position[-1]:.4f} {unit}, "
        f"all the time between {sweep.position.min():.4f} and {sweep.position.max():.4f} {unit}",
        f"speed: at most {abs(sweep.velocity).max():.4f} {unit}/s; sines of {lines} Hz",
        f"time: {blocks * sweep.cycle:.3f} s in {blocks} blocks of {1e3 * sweep.cycle:g} ms; "
        f"mean speed of a block within {velocity_bound(sweep):.1e} {unit}/s of the set-point",
        "",
        "CHECK BEFORE THE FIRST START",
        "- names, directions and zeros of the axes: does the control show the pose above where you expect it?",
        "- nobody in the cell; tool, payload and surroundings as in the plan",
        "CHECK BEFORE EVERY START",
        "- feed override 100 %, no single block, no dry run, no block search into this program",
        "- trace armed: CYCLE, ENC_POS, DES_POS, CMD_SPEED, TORQUE of the moving axis",
        "Nothing moves before NC Start after M0. After any stop inside of the sweep: reset and start anew.",
    ]
    return [f"; {_plain(text)}".rstrip() for text in texts]


def _checks(sweep: PathSweep) -> list[str]:
    resolution = "$MN_INT_INCR_PER_MM" if sweep.unit == "mm" else "$MN_INT_INCR_PER_DEG"
    return [
        "TRAFOOF",
        "G40 G90 G94 G500 G710 D0",
        "TRANS",
        "STOPRE",
        f"IF ABS($MN_IPO_CYCLE_TIME-{sweep.cycle:g})>0.00001 GOTOF BAD_CYCLE",
        f"IF {resolution}<{RESOLUTION} GOTOF BAD_RESOLUTION",
        *(f"IF ABS($AA_IW[{axis}]-$AA_IM[{axis}])>0.001 GOTOF BAD_FRAME" for axis in sweep.start),
    ]


def _way(sweep: PathSweep) -> list[str]:
    """Legs to the pose, one axis at a time, if the robot is at the planned position before them."""
    if not sweep.legs:
        return []
    return [
        "; at the pose already?",
        *_standing(sweep.start, "AWAY"),
        "GOTOF AT_POSE",
        "AWAY:",
        f'MSG("{sweep.name}: {len(sweep.legs)} single-axis moves to the pose. NC Start moves")',
        "M0",
        *_standing(sweep.before, "ELSEWHERE"),
        *(f"POS[{leg.axis}]={_number(leg.target)} FA[{leg.axis}]={leg.speed:.3f}" for leg in sweep.legs),
        "AT_POSE:",
    ]


def _standing(where: dict[str, float], otherwise: str, tolerance: float = 0.1) -> list[str]:
    """Jumps to `otherwise` unless all axes are within `tolerance`, deg (mm); also after a stop: jogging."""
    return [
        "STOPRE",
        *(
            f"IF ABS($AA_IM[{axis}]-({_number(value)}))>{tolerance:g} GOTOF {otherwise}"
            for axis, value in where.items()
        ),
    ]


def _motion(sweep: PathSweep, positions: Sequence[str]) -> list[str]:
    axis = sweep.axis
    return [
        f'MSG("{sweep.name}: {axis} moves to {sweep.position[-1]:.3f}. Override 100, trace armed? NC Start moves")',
        "M0",
        *_standing(sweep.start, "ELSEWHERE"),
        f"POS[{axis}]={_number(sweep.position[0])} FA[{axis}]=60",  # deg/min (mm/min), slowly to the start
        "STOPRE",
        "G4 F1",
        f"FGROUP({axis})",
        "BRISK",
        "COMPOF",
        "FNORM",
        f"G1 G64 G93 F{60 / sweep.cycle:.6f}",
        *(f"{axis}={position}" for position in positions),
        "STOPRE",
        "G4 F1",
        "FGROUP()",
        "MSG()",
        "M30",
    ]


def _refusal(sweep: PathSweep, label: str, reason: str) -> list[str]:
    return [f"{label}:", f'MSG("{sweep.name} refused: {reason}. Reset")', "M0", "M30"]


def _number(value: float) -> str:
    text = f"{value:.{DECIMALS}f}"
    return text.removeprefix("-") if float(text) == 0 else text


def _plain(text: str) -> str:
    """Names come from files: a comment contains only printable ASCII and no line break."""
    return "".join(letter if letter.isascii() and letter.isprintable() else "?" for letter in text)


def export_paths(folder: Path, plan: PlanDocument, robot: Robot, cell: Cell, control: CncControl) -> int:
    """Write all sweeps of a plan to a new or empty folder; returns their number. BadInput, and nothing written, for the
    first sweep that leaves the envelope or does not fit into a part program.

    ``SWEEP_0001.MPF`` and ``.csv`` for every sweep; ``mapping.yaml`` with robot and URDF for `sweepid import trace`,
    which looks for the traces in ``traces/SWEEP_0001.csv`` and so on.
    """
    sweeps: list[PathSweep] = []
    with new_folder(folder) as partial:
        for sweep in path_sweeps(plan, robot, cell, control):
            program = part_program(sweep, robot.name, control.largest_program)
            (partial / f"{sweep.name}.MPF").write_text(program, encoding="ascii")
            _write_table(partial / f"{sweep.name}.csv", sweep)
            sweeps.append(sweep)
        _write_mapping(partial, robot, control, sweeps)
        (partial / "traces").mkdir()
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


def _write_mapping(folder: Path, robot: Robot, control: CncControl, sweeps: Sequence[PathSweep]) -> None:
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
    motion = SweepTimes(ramp=planned.ramp, settle=planned.settle)
    return TraceSweep(**spec.model_dump(), source=Path("traces") / f"{sweep.name}.csv", path=motion)


def _write_yaml(path: Path, content: BaseModel) -> None:
    document = content.model_dump(mode="json", exclude_unset=True)
    path.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
