"""Converts traces (.mat, .csv, .parquet, .mf4, .h5) to a bundle with a mapping (docs/how-to/your-own-trace.md).

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
from collections.abc import Mapping as Mapping_, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import yaml
from pydantic import ValidationError
from scipy.signal import butter, sosfiltfilt

from service import BadInput
from service.formats.traces.alignment import check_follows, motion_start
from service.formats.traces.mapping import CncAxis, Columns, FromPosition, Mapping, SingleAxis, TraceSweep
from service.formats.traces.meaning import KnownTrain, SourceChannel, find_kind, scalings
from service.formats.traces.raw import Raw, read_raw, sessions_of
from service.formats.traces.tables import even, filled, spacing, unit_of_time
from service.formats.traces.units import check_same, to_si
from service.identification.design.excitation import Excitation, way
from service.identification.estimates.estimate import identify
from service.identification.spectra.frequency_response import spectrum
from service.model import Array, Axis, Recording, Robot, RobotDescription, Sweep, SweepSpec, robot_from_outside
from service.model.configuration import bad_field, read_robot, read_yaml
from service.store.files.columns import check_samples


@dataclass(frozen=True, slots=True)
class Imported:
    """What came of traces; `mapping`: the same with all that was found written out; `notes`: what was guessed."""

    robot: Robot
    sweeps: tuple[Sweep, ...]
    mapping: Mapping
    notes: tuple[str, ...]


def import_trace(mapping_file: Path, source: Path | None = None) -> tuple[Robot, tuple[Sweep, ...]]:
    """Robot and sweeps of a mapping file, not yet checked for gaps: `write_bundle` does that.

    `source` replaces the trace file of a mapping with one sweep. BadInput names file, field and reason.
    """
    made = read_traces(read_yaml(mapping_file, Mapping), mapping_file, source)
    return made.robot, made.sweeps


def of_file(
    path: Path,
    robot: SingleAxis,
    file_axis: str | None = None,
    torque_constant: float | None = None,
    sample_rate: float | None = None,
) -> Mapping:
    """The mapping of a trace alone: one axis, a sweep for each session of the file; the rest is found in it."""
    count = sessions_of(path)
    known: dict[str, object] = {"source": Path(path.name), "axis": robot.joint, "file_axis": file_axis}
    known |= {} if sample_rate is None else {"sample_rate": sample_rate}
    numbers = [{"id": f"{k:04d}", "group": k if count > 1 else None} for k in range(1, count + 1)]
    sweeps = tuple(TraceSweep.model_validate(known | number) for number in numbers)
    return Mapping(robot=robot, axes={robot.joint: CncAxis(torque_constant=torque_constant)}, sweeps=sweeps)


def read_traces(mapping: Mapping, mapping_file: Path, source: Path | None = None) -> Imported:
    """Robot, sweeps and guesses; files of the mapping are relative to `mapping_file`."""
    if source is not None and len(mapping.sweeps) > 1:
        raise BadInput(str(mapping_file), f"names {len(mapping.sweeps)} traces: --source can replace only one")
    given = mapping.robot
    if isinstance(given, SingleAxis):
        _single_axis_robot(given, str(mapping_file))  # what is given is possible
        robot = None
    else:
        robot = read_robot(mapping_file.parent / given)
    name = given.name if isinstance(given, SingleAxis) else robot.name if robot is not None else ""
    joints = (given.joint,) if isinstance(given, SingleAxis) else () if robot is None else robot.joints
    for joint in mapping.axes:
        if joint not in joints:
            raise BadInput(f"{mapping_file} axes", f"unknown joint {joint}; there are {', '.join(joints)}")
    entries = [_whole(entry, number, joints) for number, entry in enumerate(mapping.sweeps, start=1)]
    traces = [(source or mapping_file.parent / entry.source, entry) for entry in entries]
    for path, entry in traces:
        if entry.axis not in joints or len(entry.pose) not in ((0, 1) if len(joints) == 1 else (len(joints),)):
            there = f"robot {name}, which has {', '.join(joints)}"
            reason = f"axis {entry.axis} in pose {entry.pose} does not exist on {there}"
            if entry.axis in joints and not entry.pose:
                reason = f"has no pose: give the positions of all axes at its start, rad (m), of {there}"
            raise BadInput(f"{path} sweep {entry.id}", reason)
    notes: dict[str, None] = {}
    made: list[tuple[TraceSweep, _Converted, str]] = []
    columns = mapping.columns
    for (path, entry), raw in zip(traces, read_raw(mapping, traces), strict=True):
        place = f"{path} sweep {entry.id}"
        train = _train(given, robot, mapping, entry.axis)
        converted = _convert(mapping, train, entry, raw, place)
        if isinstance(given, SingleAxis):
            kind = "prismatic" if train.prismatic else "revolute"
            given = given.model_copy(update={"kind": kind, "gear_ratio": train.gear_ratio or 1.0})
        notes |= dict.fromkeys((*raw.notes, *train.notes))
        columns = converted.columns
        made.append((entry, converted, place))
        del raw  # as large as what came of it
    if isinstance(given, SingleAxis):
        given, robot, told = _drafted(given, [one.taken for _, one, _ in made], str(mapping_file))
        notes |= dict.fromkeys(told)
    if robot is None:
        raise BadInput(str(mapping_file), "has no robot")
    sweeps = [_sweep(robot, entry, converted, place) for entry, converted, place in made]
    if isinstance(given, SingleAxis) and given.inertia is None:
        inertia = _nominal(robot, sweeps)
        given = given.model_copy(update={"inertia": inertia or 1.0})
        robot = _single_axis_robot(given, str(mapping_file))
        shown = f"{given.inertia:.4g} {'kg' if given.kind == 'prismatic' else 'kg m^2'}"
        found = f"nominal inertia {shown}: that of this trace; check compares with one of a data sheet"
        notes[found if inertia else f"this trace shows no inertia: the nominal one is set to {shown}"] = None
    whole = [
        entry.model_copy(update=sweep.spec.model_dump() | {"source": path.resolve()})
        for (path, entry), sweep in zip(traces, sweeps, strict=True)
    ]
    written = mapping.model_copy(update={"robot": given, "columns": columns, "sweeps": tuple(whole)})
    return Imported(robot, tuple(sweeps), written, tuple(notes))


def _whole(entry: TraceSweep, number: int, joints: tuple[str, ...]) -> TraceSweep:
    """With what follows from the rest of the mapping."""
    update: dict[str, object] = {}
    if "id" not in entry.model_fields_set:
        update["id"] = f"{number:04d}"
    if "axis" not in entry.model_fields_set and len(joints) == 1:
        update["axis"] = joints[0]
    if "excitation" not in entry.model_fields_set and not entry.sines:
        update["excitation"] = "trajectory"
    return entry.model_copy(update=update)


def _train(given: Path | SingleAxis, robot: Robot | None, mapping: Mapping, joint: str) -> KnownTrain:
    constant = mapping.axes.get(joint, CncAxis()).torque_constant
    if isinstance(given, SingleAxis):
        slides = None if given.kind is None else given.kind == "prismatic"
        return KnownTrain(slides, given.gear_ratio, given.rated_effort, constant)
    if robot is None:
        return KnownTrain(torque_constant=constant)
    axis = robot.axis(joint)
    slides = robot.chain.joints[robot.index(joint)].kind == "prismatic"
    return KnownTrain(slides, axis.gear_ratio, axis.rated_effort, constant, fixed=True)


def _drafted(
    given: SingleAxis, taken: Sequence[Mapping_[str, Array]], place: str
) -> tuple[SingleAxis, Robot, tuple[str, ...]]:
    """The axis with what is not known of it from the samples."""
    low = min(float(np.nanmin(one["position"])) for one in taken)
    high = max(float(np.nanmax(one["position"])) for one in taken)
    margin = max(0.1 * (high - low), 1e-3)
    fastest = max(float(np.nanmax(np.abs(one["velocity"]))) for one in taken)
    largest = max(float(np.nanmax(np.abs(one["effort"]))) for one in taken)
    found = {
        "lower": low - margin,
        "upper": high + margin,
        "velocity": max(1.2 * fastest, 1e-6),
        "rated_effort": max(largest, 1e-6),
    }
    unknown = {name: float(f"{value:.6g}") for name, value in found.items() if getattr(given, name) is None}
    if not all(map(math.isfinite, unknown.values())):
        raise BadInput(place, "the trace has values that are missing")
    told = ", ".join(f"{name} {value:.4g}" for name, value in unknown.items())
    whole = given.model_copy(update=unknown)
    return whole, _single_axis_robot(whole, place), (f"of the axis, {told}: from the trace",) if unknown else ()


def _nominal(robot: Robot, sweeps: Sequence[Sweep]) -> float | None:
    """kg m^2 (kg) about the axis, by the sweeps; None where they do not show it."""
    try:
        (axis,) = identify(robot, [spectrum(robot, sweep) for sweep in sweeps]).axes
        # standard deviations of an inertia that a trace shows
        values = [one.value for one in axis.sweeps if one.value > 3.0 * one.std]
    except (BadInput, ValueError, ArithmeticError, np.linalg.LinAlgError):
        return None
    return float(f"{np.median(values):.6g}") if values else None


def _sweep(robot: Robot, entry: TraceSweep, converted: "_Converted", place: str) -> Sweep:
    taken = dict(converted.taken)
    set_position = taken.pop("set_position", None)
    recording = Recording(**taken)
    pose = entry.pose or (float(recording.position[0]),)
    fields = entry.model_dump(exclude={"source", "group", "path", "file_axis"})
    spec = SweepSpec.model_validate(fields | {"pose": pose, "sample_rate": converted.sample_rate})
    if entry.path is not None and set_position is not None:
        start = _aligned(entry, recording, set_position, pose[robot.index(entry.axis)], place)
        spec = spec.model_copy(update={"measure_from": start + entry.path.ramp + entry.path.settle})
    return Sweep(spec, recording)


def differentiate(signal: Array, sample_rate: float, corner: float) -> Array:
    """Time derivative (n,) of a signal (n,) sampled at `sample_rate` Hz, without phase; see the module docstring."""
    sections = cast(Array, butter(4, corner, fs=sample_rate, output="sos"))
    # f'(x) h of order 8 from samples at x+1 h ... x+4 h minus those at x-1 h ... x-4 h (Fornberg 1988, table 1)
    central = (4 / 5, -1 / 5, 4 / 105, -1 / 280)
    middle = len(central)
    # samples of odd reflection until the filter has settled: its slowest pole decays as exp(-2.4 corner t)
    run_in = int(10 * sample_rate / corner)
    smooth = np.pad(sosfiltfilt(sections, signal, padlen=run_in), middle, mode="reflect", reflect_type="odd")
    derivative = np.zeros(len(signal))
    for distance, weight in enumerate(central, start=1):
        ahead = smooth[middle + distance : middle + distance + len(signal)]
        behind = smooth[middle - distance : middle - distance + len(signal)]
        derivative += weight * sample_rate * (ahead - behind)
    return derivative


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


@dataclass(frozen=True, slots=True)
class _Converted:
    """SI on the joint side, `set_position` among them; `columns`: the conversion of each."""

    taken: dict[str, Array]
    sample_rate: float
    columns: Columns


def _convert(mapping: Mapping, train: KnownTrain, entry: TraceSweep, raw: Raw, place: str) -> _Converted:
    rate = entry.sample_rate if "sample_rate" in entry.model_fields_set else None
    sampled = {name: filled(values) for name, values in raw.columns.items() if name != "time"}
    time, scaled = _time(raw, rate, train, len(raw.columns["position"]), place)
    time, sampled, told = even(time, sampled, place)
    for one in told:
        train.tell(one)
    if rate is None:
        step = spacing(time)
        rate = float(f"{1 / step:.6g}") if step > 0 else 1.0
    channels = {
        name: SourceChannel(raw.sources[name], raw.units.get(name, ""), values, name not in raw.found)
        for name, values in sampled.items()
    }
    for name, one in channels.items():
        if one.column.unit is not None and one.unit:
            check_same(one.column.unit, one.unit, f"{place} column {name}")
    find_kind(train, channels, time)
    if "load_velocity" in raw.found and "load_position" not in channels:
        del channels["load_velocity"]  # of the encoder that position is of
    found = scalings(train, channels, time, place)
    axis = _axis(train, entry.axis, channels, place)
    cnc = mapping.axes.get(entry.axis, CncAxis(name="axis"))
    position_unit = 1e-3 if train.prismatic else math.radians(1.0)
    taken: dict[str, Array] = {"time": time - time[:1]}  # the clock of a bundle starts with the sweep
    for name, one in channels.items():
        scale, offset = found.get(name) or one.column.to_si(axis, cnc, position_unit, rate)
        taken[name] = scale * one.values + offset
        found[name] = (scale, offset)
    if "load_position" in raw.found:  # two encoders need not have one zero
        apart = float(taken["load_position"][0] - taken["position"][0])
        taken["load_position"] = taken["load_position"] - apart
        found["load_position"] = (found["load_position"][0], found["load_position"][1] - apart)
    velocity = mapping.columns.velocity
    if "velocity" not in taken:
        if not isinstance(velocity, FromPosition):
            velocity = FromPosition(from_position=min(100.0, float(f"{0.4 * rate:.3g}")))
            train.tell(f"no speed in the file: position is differentiated, low-pass of {velocity.from_position:g} Hz")
        taken["velocity"] = _derived(taken["position"], rate, velocity.from_position, place)
    written = {
        name: raw.sources[name].model_copy(update={"unit": None, "scale": scale, "offset": offset})
        for name, (scale, offset) in found.items()
        if name in raw.sources
    }
    if scaled is not None and "time" in raw.sources:
        written["time"] = raw.sources["time"].model_copy(update={"unit": None, "scale": scaled, "offset": 0.0})
    kept = {"velocity": velocity} if isinstance(velocity, FromPosition) else {}
    return _Converted(taken, rate, Columns.model_validate({**written, **kept}))


def _axis(train: KnownTrain, joint: str, channels: Mapping_[str, SourceChannel], place: str) -> Axis:
    rated = train.rated_effort
    if rated is None and any(one.column.unit == "percent" for one in channels.values()):
        raise BadInput(place, "is in percent of the rated torque: give `rated_effort` of the axis")
    try:
        return Axis(joint=joint, gear_ratio=train.gear_ratio or 1.0, rated_effort=rated or 1.0)
    except ValidationError as error:
        raise bad_field(f"{place} robot", error) from None


def _time(raw: Raw, rate: float | None, train: KnownTrain, count: int, place: str) -> tuple[Array, float | None]:
    """s, and its factor: by mapping, file or step; the file's own clock; the sample rate."""
    if "time" in raw.columns:
        column, values = raw.sources["time"], raw.columns["time"]
        if column.unit is not None or column.scaled:
            factor = column.to_si(Axis(joint="time", gear_ratio=1.0, rated_effort=1.0), CncAxis(), 1.0, rate or 1.0)
            return factor[0] * values + factor[1], None
        if raw.units.get("time"):
            scale = to_si("time", raw.units["time"], False, f"{place} column time")[0]
            return scale * values, scale
        if "time" not in raw.found:
            return values, None
        unit, scale = unit_of_time(values, rate)
        steps = np.diff(values) * scale
        if rate is not None and not abs(float(np.median(steps)) * rate - 1) < 0.1:
            train.tell(f"{column.name} does not run at the sample rate, and is not used")
        else:
            if unit != "s":
                train.tell(f"{column.name} has no unit; by its step it is {unit}")
            return scale * values, scale
    if raw.clock is not None:
        return raw.clock, None
    if rate is None:
        raise BadInput(place, "has no time: give `sample_rate` of the sweep, or --sample-rate")
    return np.arange(count) / rate, None


def _derived(position: Array, sample_rate: float, corner: float, place: str) -> Array:
    """Velocity of a position (n,); BadInput if the filter cannot be applied."""
    if corner >= sample_rate / 2:
        raise BadInput(place, f"low-pass of {corner} Hz is not below half the sample rate {sample_rate} Hz")
    if not np.isfinite(position).all():
        raise BadInput(place, "a position is missing; the low-pass filter needs all positions")
    if not len(position) > 10 * sample_rate / corner:
        raise BadInput(place, f"{len(position)} samples are too few for a low-pass of {corner} Hz")
    return differentiate(position, sample_rate, corner)


def _single_axis_robot(axis: SingleAxis, place: str) -> Robot:
    inertia, rated, fastest = axis.inertia or 1.0, axis.rated_effort or 1.0, axis.velocity or 1.0
    lower, upper = -1.0 if axis.lower is None else axis.lower, 1.0 if axis.upper is None else axis.upper
    turning, mass = (1.0, inertia) if axis.kind == "prismatic" else (inertia, 1.0)
    urdf = f"""<?xml version="1.0"?>
<robot name="single-axis">
  <link name="base"/>
  <link name="load">
    <inertial>
      <mass value="{mass!r}"/>
      <inertia ixx="{turning!r}" iyy="{turning!r}" izz="{turning!r}" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <joint name="{axis.joint}" type="{axis.kind or "revolute"}">
    <parent link="base"/>
    <child link="load"/>
    <axis xyz="1 0 0"/>
    <limit lower="{lower!r}" upper="{upper!r}" velocity="{fastest!r}" effort="{rated!r}"/>
  </joint>
</robot>
"""
    try:
        drive = Axis(
            joint=axis.joint,
            gear_ratio=1.0 if axis.gear_ratio is None else axis.gear_ratio,
            motor_inertia=axis.motor_inertia,
            rated_effort=rated,
            viscous_friction=axis.viscous_friction,
        )
        description = RobotDescription(name=axis.name, urdf="robot.urdf", axes=(drive,), prior=axis.prior)
    except ValidationError as error:
        raise bad_field(f"{place} robot", error) from None
    return robot_from_outside(description, urdf, f"{place} robot")


def mapping_of(
    path: Path,
    *,
    axis: str | None = None,
    torque_constant: float | None = None,
    sample_rate: float | None = None,
    **known: Any,
) -> Mapping:
    """A mapping file (YAML), or the mapping of a trace file; `known`: fields of the axis. BadInput names the field."""
    if path.suffix.lower() in (".yaml", ".yml"):
        return read_yaml(path, Mapping)
    given = {name: value for name, value in known.items() if value is not None}
    name = "".join(letter for letter in path.stem if letter.isprintable())[:200] or "trace"
    try:
        return of_file(path, SingleAxis(name=name, joint="axis", **given), axis, torque_constant, sample_rate)
    except ValidationError as error:
        raise bad_field(str(path), error) from None


def mapping_text(made: Imported) -> str:
    """The whole mapping as YAML, with the guesses as comments."""
    content = made.mapping.model_dump(mode="json", exclude_defaults=True)
    content["robot"] = made.mapping.model_dump(mode="json", exclude_none=True)["robot"]
    notes = "".join(f"# {note}\n" for note in made.notes)
    return notes + yaml.safe_dump(content, sort_keys=False, allow_unicode=True)
