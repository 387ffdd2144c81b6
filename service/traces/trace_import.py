r"""Converts traces (.mat, .csv, .parquet, .mf4, .h5) to a bundle with a mapping (docs/how-to/your-own-trace.md).

For a machine that records position but no velocity, the mapping contains ``velocity: {from_position: 100}``; the
number is the corner of a low-pass filter in Hz. The differentiation must not look like inertia:

- a central difference of second order has the gain ``sin(w T) / (w T) = 1 - (w T)^2 / 6``, an error that
    increases with f^2 exactly like joint elasticity; with order 8 the error is ``-(w T)^8 / 630``, 1e-10 at 20 Hz and
  1 kHz;
- the filter is a Butterworth of order 4 run forwards and backwards: no phase, so no delay of speed to torque
    and no false friction; its gain is ``1 / (1 + (f / f_c)^8)``, 3e-6 below one at a fifth of the corner.

Both ends are extended by odd reflection, which keeps value and slope. Identification uses bins below 20 Hz; the corner
should be at least five times higher.
"""

import math
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError
from scipy.signal import butter, sosfiltfilt

from service.configuration import bad_field, read_robot, read_yaml
from service.errors import BadInput
from service.identification.design.excitation import Excitation
from service.identification.design.sweep_path import way
from service.recording import Recording, Sweep, SweepSpec
from service.robot import Axis, Robot, RobotDescription, robot_from_outside
from service.store.files.columns import check_samples
from service.traces.alignment import check_follows, motion_start
from service.traces.mapping import CncAxis, FromPosition, Mapping, SingleAxis, TraceSweep
from service.traces.raw import Raw, read_raw
from service.traces.units import check_same, to_si

Array = NDArray[np.float64]

# f'(x) h of order 8 from samples at x+1 h ... x+4 h minus those at x-1 h ... x-4 h (Fornberg 1988, table 1)
_CENTRAL = (4 / 5, -1 / 5, 4 / 105, -1 / 280)
_SETTLED = 10  # periods of the corner


def import_trace(mapping_file: Path, source: Path | None = None) -> tuple[Robot, tuple[Sweep, ...]]:
    """Robot and sweeps of a mapping file, not yet checked for gaps: `write_bundle` does that.

    `source` replaces the trace file of a mapping with one sweep. BadInput names file, field and reason.
    """
    mapping = read_yaml(mapping_file, Mapping)
    if source is not None and len(mapping.sweeps) > 1:
        raise BadInput(str(mapping_file), f"names {len(mapping.sweeps)} traces: --source can replace only one")
    if isinstance(mapping.robot, SingleAxis):
        robot = _single_axis_robot(mapping.robot, str(mapping_file))
    else:
        robot = read_robot(mapping_file.parent / mapping.robot)
    sweeps: list[Sweep] = []
    for joint in mapping.axes:
        if joint not in robot.joints:
            raise BadInput(f"{mapping_file} axes", f"unknown joint {joint}; there are {', '.join(robot.joints)}")
    traces = [(source or mapping_file.parent / entry.source, entry) for entry in mapping.sweeps]
    for path, entry in traces:
        if entry.axis not in robot.joints or len(entry.pose) != len(robot.joints):
            where = f"axis {entry.axis} in pose {entry.pose}"
            raise BadInput(
                f"{path} sweep {entry.id}",
                f"{where} does not exist on robot {robot.name}, which has {', '.join(robot.joints)}",
            )
    for (path, entry), raw in zip(traces, read_raw(mapping, traces), strict=True):
        place = f"{path} sweep {entry.id}"
        taken = _columns(mapping, robot, entry, raw, path)
        set_position = taken.pop("set_position", None)
        recording = Recording(**taken)
        spec = SweepSpec.model_validate(entry.model_dump(exclude={"source", "group", "path"}))
        if entry.path is not None and set_position is not None:
            start = _aligned(entry, recording, set_position, entry.pose[robot.index(entry.axis)], place)
            spec = spec.model_copy(update={"measure_from": start + entry.path.ramp + entry.path.settle})
        sweeps.append(Sweep(spec, recording))
    return robot, tuple(sweeps)


def differentiate(signal: Array, sample_rate: float, corner: float) -> Array:
    """Time derivative (n,) of a signal (n,) sampled at `sample_rate` Hz, without phase; see the module docstring."""
    sections = cast(Array, butter(4, corner, fs=sample_rate, output="sos"))
    run_in = _run_in(sample_rate, corner)
    smooth = np.pad(sosfiltfilt(sections, signal, padlen=run_in), len(_CENTRAL), mode="reflect", reflect_type="odd")
    derivative = np.zeros(len(signal))
    for distance, weight in enumerate(_CENTRAL, start=1):
        middle = len(_CENTRAL)
        ahead = smooth[middle + distance : middle + distance + len(signal)]
        behind = smooth[middle - distance : middle - distance + len(signal)]
        derivative += weight * sample_rate * (ahead - behind)
    return derivative


def _run_in(sample_rate: float, corner: float) -> int:
    """Samples of odd reflection until the filter has settled: its slowest pole decays as exp(-2.4 corner t)."""
    return int(_SETTLED * sample_rate / corner)


def _aligned(entry: TraceSweep, recording: Recording, set_position: Array, position: float, place: str) -> float:
    """Start time of the sweep's motion in its trace, s; BadInput if the trace does not contain this motion."""
    if entry.path is None or entry.period is None or entry.periods is None:
        raise BadInput(place, "has no path")
    ramp, settle = entry.path.ramp, entry.path.settle
    path = Excitation(entry.offset_velocity, entry.sines, entry.period, entry.periods, ramp, settle)
    if not np.isfinite(set_position).all():
        raise BadInput(place, "a set position is missing")
    check_samples(recording, place)
    start = motion_start(path, position, recording.time, set_position, place)
    time = recording.time - start
    moving = (time >= 0) & (time <= path.duration)
    expected = way(path, time[moving])
    check_follows("position", recording.position[moving], expected, place)
    # speeds are compared by their integral, which hardly depends on the control loops at 5 Hz
    step = 1 / entry.sample_rate
    check_follows("velocity", np.cumsum(recording.velocity[moving]) * step, expected, place)
    if recording.velocity_setpoint is not None:
        check_follows("velocity_setpoint", np.cumsum(recording.velocity_setpoint[moving]) * step, expected, place)
    return start


def _columns(mapping: Mapping, robot: Robot, entry: TraceSweep, raw: Raw, path: Path) -> dict[str, Array]:
    """The columns of a sweep's trace, SI on the joint side, including `set_position`."""
    columns, sample_rate = mapping.columns, entry.sample_rate
    axis = robot.axis(entry.axis)
    cnc = mapping.axes.get(entry.axis, CncAxis(name="axis"))
    prismatic = robot.chain.joints[robot.index(entry.axis)].kind == "prismatic"
    position_unit = 1e-3 if prismatic else math.radians(1.0)
    taken: dict[str, Array] = {}
    for name, column in columns.sources.items():
        stated, here = raw.units.get(name, ""), f"{path} sweep {entry.id} column {name}"
        if stated and column.unit is not None:
            check_same(column.unit, stated, here)
        if stated and column.unit is None and not column.scaled:
            scale, offset = to_si(name, stated, prismatic, here)
        else:
            scale, offset = column.to_si(axis, cnc, position_unit, sample_rate)
        taken[name] = scale * raw.columns[name] + offset
    position = taken["position"]
    time = taken.get("time", raw.clock)
    if time is not None:
        taken["time"] = time - time[:1]  # the clock of a bundle starts with the sweep
    else:
        taken["time"] = np.arange(len(position)) / sample_rate
    if isinstance(columns.velocity, FromPosition):
        taken["velocity"] = _derived(position, sample_rate, columns.velocity.from_position, str(path))
    return taken


def _derived(position: Array, sample_rate: float, corner: float, place: str) -> Array:
    """Velocity of a position (n,); BadInput if the filter cannot be applied."""
    if corner >= sample_rate / 2:
        raise BadInput(place, f"low-pass of {corner} Hz is not below half the sample rate {sample_rate} Hz")
    if not np.isfinite(position).all():
        raise BadInput(place, "a position is missing; the low-pass filter needs all positions")
    if not len(position) > _SETTLED * sample_rate / corner:
        raise BadInput(place, f"{len(position)} samples are too few for a low-pass of {corner} Hz")
    return differentiate(position, sample_rate, corner)


def _single_axis_robot(axis: SingleAxis, place: str) -> Robot:
    turning = axis.inertia if axis.kind == "revolute" else 1.0
    mass = axis.inertia if axis.kind == "prismatic" else 1.0
    urdf = f"""<?xml version="1.0"?>
<robot name="single-axis">
  <link name="base"/>
  <link name="load">
    <inertial>
      <mass value="{mass!r}"/>
      <inertia ixx="{turning!r}" iyy="{turning!r}" izz="{turning!r}" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <joint name="{axis.joint}" type="{axis.kind}">
    <parent link="base"/>
    <child link="load"/>
    <axis xyz="1 0 0"/>
    <limit lower="{axis.lower!r}" upper="{axis.upper!r}" velocity="{axis.velocity!r}" effort="{axis.rated_effort!r}"/>
  </joint>
</robot>
"""
    try:
        drive = Axis(
            joint=axis.joint,
            gear_ratio=axis.gear_ratio,
            motor_inertia=axis.motor_inertia,
            rated_effort=axis.rated_effort,
            viscous_friction=axis.viscous_friction,
        )
        description = RobotDescription(name=axis.name, urdf="robot.urdf", axes=(drive,), prior=axis.prior)
    except ValidationError as error:
        raise bad_field(f"{place} robot", error) from None
    return robot_from_outside(description, urdf, f"{place} robot")
