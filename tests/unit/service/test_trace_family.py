"""Traces as controls, drives and robots write them, each made from one stated motion: what comes out is that motion."""

import json
import math
import struct
import tracemalloc
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from itertools import permutations
from pathlib import Path
from typing import Any, cast

import asammdf
import h5py
import numpy as np
import pytest
import yaml
from asammdf.blocks.v4_blocks import ChannelConversion
from hypothesis import HealthCheck, given, settings, strategies as st
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scipy.io import savemat

from service import BadInput
from service.formats.traces.containers import ChannelName
from service.formats.traces.mapping import Csv
from service.formats.traces.tables import TextTable
from service.formats.traces.trace_import import Imported, import_trace, mapping_of, mapping_text, read_traces
from service.model import Recording
from service.store.files.columns import write_columns

Array = np.ndarray[Any, np.dtype[np.float64]]
_h5 = cast(Any, h5py)  # without types

pytestmark = pytest.mark.slow

RATE, ROWS, GEAR = 250.0, 500, 50.0
TIME = np.arange(ROWS) / RATE
_LINES = ((1.0, 0.4, 0.0), (2.0, 0.1, 1.0), (3.0, 0.05, 2.0))
SPEED = np.asarray(0.3 + sum(size * np.sin(math.tau * hertz * TIME + phase) for hertz, size, phase in _LINES))
WAY = 0.3 * TIME - np.asarray(
    sum(size / (math.tau * hertz) * np.cos(math.tau * hertz * TIME + phase) for hertz, size, phase in _LINES)
)
_PULL = sum(math.tau * hertz * size * np.cos(math.tau * hertz * TIME + phase) for hertz, size, phase in _LINES)
TORQUE = np.asarray(4.0 * _PULL + 6.0 * SPEED + 2.5 * np.sign(SPEED))
RPM = 60 / math.tau
MOVED: dict[str, Array] = {"M [Nm]": TORQUE, "n [rad/s]": SPEED, "phi [rad]": WAY}
PLAIN: dict[str, Array] = {"time [s]": TIME, **MOVED}


def imported(path: Path, **given: Any) -> Imported:
    return read_traces(mapping_of(path, **given), path)


def shows(made: Imported, tolerance: float = 2e-5) -> Imported:
    """The stated motion, and an inertia of 4 kg m^2 (kg)."""
    for name, truth in (("effort", TORQUE), ("velocity", SPEED), ("position", WAY)):
        found = getattr(made.sweeps[0].recording, name)
        np.testing.assert_allclose(found, truth, atol=tolerance * np.ptp(truth), err_msg=name)
    assert made.sweeps[0].spec.sample_rate == pytest.approx(RATE, rel=1e-3)
    return made


def text(
    columns: Mapping[str, Sequence[Any] | Array], delimiter: str = ",", point: str = ".", head: str | None = None
) -> str:
    rows = zip(*columns.values(), strict=True)
    cells = [
        delimiter.join(one if isinstance(one, str) else f"{one:.9f}".replace(".", point) for one in row) for row in rows
    ]
    return "\n".join([delimiter.join(columns) if head is None else head, *cells, ""])


def written(folder: Path, content: str, name: str = "trace.csv", encoding: str = "utf-8") -> Path:
    (folder / name).write_bytes(content.encode(encoding))
    return folder / name


def mapped(folder: Path, source: str, columns: dict[str, Any]) -> Path:
    """A mapping file that names some columns of the trace."""
    robot = {"name": "table", "joint": "c", "kind": "revolute", "inertia": 4.0}
    content = {"robot": robot, "columns": columns, "sweeps": [{"source": source}]}
    return written(folder, yaml.safe_dump(content), "mapping.yaml")


@given(
    form=st.sampled_from(
        [(",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ","), ("|", ","), ("  ", "."), ("\t ", ",")]
    ),
    encoding=st.sampled_from(["utf-8", "utf-8-sig", "cp1252", "utf-16", "utf-16-le", "utf-16-be", "utf-32"]),
    end=st.sampled_from(["\n", "\r\n", "\r"]),
    order=st.permutations(list(PLAIN)),
    around=st.sampled_from(["", " "]),
    name=st.sampled_from(["trace.csv", "TRACE.CSV", "trace.txt", "trace.dat", "trace.log", "trace"]),
    more=st.sampled_from([{}, {"Temperatur Gehäuse [°C]": np.full(ROWS, 21.0)}]),
)
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_text_of_the_same_table(
    form: tuple[str, str],
    encoding: str,
    end: str,
    order: list[str],
    around: str,
    name: str,
    more: dict[str, Array],
    tmp_path: Path,
) -> None:
    delimiter, point = form
    columns = {one: (PLAIN | more)[one] for one in (*order, *more)}
    joint = around + delimiter if delimiter.strip() else delimiter
    if delimiter.isspace() and delimiter != "\t":  # blanks separate: no blanks in names
        columns = {one.replace(" ", ""): column for one, column in columns.items()}
    content = text(columns, joint, point).replace("\n", end)
    shows(imported(written(tmp_path, content, name, encoding)))


# delimiter, decimal point, heading
HEADINGS: dict[str, tuple[str, str, str]] = {
    "names and units in rows": (";", ",", "Zeit;Drehmoment;Drehzahl;Winkel\ns;Nm;rad/s;rad"),
    "units in brackets, in a row": (";", ".", "t;Torque;Speed;Position\n[s];[Nm];[rad/s];[rad]"),
    "keys before": (",", ".", "Projekt,Test 7\nBediener,Müller\nDatum,15.01.2026\n\ntime,M,n,phi\ns,N m,rad/s,rad"),
    "a row of types between": (";", ".", "time;M;n;phi\nLREAL;LREAL;LREAL;LREAL\ns;Nm;rad/s;rad"),
    "the separator of Excel": (";", ",", "sep=;\nt [s];M [Nm];n [rad/s];phi [rad]"),
    "quoted": (",", ".", '"t [s]","M [Nm]","n [rad/s]","phi [rad]"'),
    "a comment": (" ", ".", "# t_s M_Nm qd_rad_s q_rad"),
    "a comment without blank": (",", ".", "%t (s),M (Nm),n (rad/s),phi (rad)"),
    "CODESYS": (" ", ".", "BODAS Trace\nD:\\P.PRO\nZeit_s PLC_PRG.fTorque_Nm GVL.n_rad_s GVL.phi_rad"),
    "ctrlX": (";", ".", "Time;A1.ActualTorque;A1.ActualVelocity;A1.ActualPosition\n[s];[Nm];[rad/s];[rad]"),
    "KUKA": (";", ",", "Zeit [s];Moment_Ist_A1 [Nm];Achsgeschw_Ist_A1 [rad/s];Achspos_Ist_A1 [rad]"),
    "ABB": ("\t", ".", "Time (s)\tTorque_J1 (Nm)\tSpeed_J1 (rad/s)\tPos_J1 (rad)"),
    "variables of a PLC": (
        ";",
        ".",
        '"Timestamp [s]";"PLC.Axis1.ActTorque [Nm]";"PLC.Axis1.ActVelocity [rad/s]";"PLC.Axis1.ActPosition [rad]"',
    ),
}


def scope(step: Array, point: str) -> str:
    """TwinCAT's Scope: pairs of time and value."""
    keys = {"Name": ["M", "n", "phi"], "SymbolComment": [""] * 3, "Data-Type": ["REAL64"] * 3}
    keys |= {"SampleTime[ms]": ["4"] * 3, "IndexGroup": ["16448"] * 3, "Unit": ["Nm", "rad/s", "rad"]}
    head = "Name\tYT Scope Project\nFile\tC:\\x.svdx\nStarttime of export\t132959733843760000\tMontag, 2. Mai 2022\n\n"
    head += "".join("\t".join(cell for one in values for cell in (key, one)) + "\n" for key, values in keys.items())
    pairs = {name: column for k, one in enumerate(MOVED.values()) for name, column in ((f"t{k}", step), (f"v{k}", one))}
    return f"{head}\n" + text(pairs, "\t", point).split("\n", 1)[1] + "EOF"


def stamped(stamp: Callable[[datetime], str], start: datetime, more: Array | float = 0.0) -> str:
    """With stamps of a wall clock."""
    stamps = [stamp(start + timedelta(seconds=float(at))) for at in TIME + more]
    return text({"Zeitstempel": stamps, **MOVED}, ";")


STAMPS: dict[str, Callable[[datetime], str]] = {
    "German": lambda at: f"{at:%d.%m.%Y %H:%M:%S},{at.microsecond // 1000:03}",
    "ISO": lambda at: at.isoformat(timespec="milliseconds"),
    "American": lambda at: f"{at:%m/%d/%Y %I:%M:%S}.{at.microsecond // 1000:03} {at:%p}",
    "time of day": lambda at: f"{at:%H:%M:%S.%f}",
}
DAY, MIDNIGHT = datetime(2026, 1, 15, 8, tzinfo=UTC), datetime(2026, 1, 15, 23, 59, 59, tzinfo=UTC)
OCTOBER = datetime(2026, 10, 25, 2, 59, 59, tzinfo=UTC)
HAL = {"joint.0.torque": TORQUE, "joint.0.vel-fb": SPEED, "joint.0.pos-fb": WAY}
VIEW = "# Position: 0.5;0.5;0.75\n# Scale: -2;0;1\n"


def hal(order: Sequence[int], kept: str) -> str:
    """Of LinuxCNC: no units, so that what has none is what physics says; `kept`: set-up of its view."""
    head, _, body = text(dict(list(HAL.items())[k] for k in order), ";").partition("\n")
    return f"# Sampling period is 4000000 ns\n{head}\n{kept}{body}"


TEXTS: dict[str, str] = {
    **{name: text(PLAIN, *form) for name, form in HEADINGS.items()},
    **{
        f"Scope {point} {unit}": scope(TIME * by, point) for point in ",." for unit, by in (("ms", 1e3), ("rows", RATE))
    },
    "Scope with names": text({"t": TIME * 1e3, **MOVED}, head="Name,proj\nFile,x.svdx\n\nName,M,n,phi"),
    **{name: stamped(stamp, DAY) for name, stamp in STAMPS.items()},
    **{f"{name} at midnight": stamped(stamp, MIDNIGHT) for name, stamp in STAMPS.items()},
    "end of summer time": stamped(lambda at: f"{at:%d.%m.%Y %H:%M:%S.%f}", OCTOBER, np.where(TIME >= 1, -3600.0, 0.0)),
    "ms without unit": text({"time": TIME * 1000, **MOVED}),
    "us of an epoch": text({"timestamp": 1.7e15 + np.round(TIME * 1e6), **MOVED}),
    "ns": text({"stamp [ns]": TIME * 1e9, **MOVED}),
    "rounded to 10 ms": text({"time [s]": np.round(TIME, 2), **MOVED}),
    **{
        told: f"{told}\n\n" + text(MOVED, ";")
        for told in ("Abtastrate;250 Hz", "SampleTime[ms];4", "sample period: 0.004 s", "# sampling period = 4e6 nSec")
    },
    **{f"HALscope {order} {bool(kept)}": hal(order, kept) for order in permutations(range(3)) for kept in ("", VIEW)},
}


@pytest.mark.parametrize("name", TEXTS)
def test_texts(name: str, tmp_path: Path) -> None:
    shows(imported(written(tmp_path, TEXTS[name])))


def test_a_rate_that_is_given_is_the_clock(tmp_path: Path) -> None:
    shows(imported(written(tmp_path, text(MOVED)), sample_rate=RATE))


def test_a_column_that_occurs_twice_is_named_by_its_number(tmp_path: Path) -> None:
    path = written(tmp_path, text({**PLAIN, "time": TIME}, head="time [s],M [Nm],n [rad/s],phi [rad],time [s]"))
    shows(imported(path))
    told = r"column 'time' occurs twice: name it as 'time \(column 1\)' or 'time \(column 5\)'"
    with pytest.raises(BadInput, match=told):
        import_trace(mapped(tmp_path, "trace.csv", {"time": {"source": "time"}}))


def test_a_text_is_read_in_less_memory_than_three_times_its_size(tmp_path: Path) -> None:
    path = written(tmp_path, text({name: np.tile(column, 100) for name, column in PLAIN.items()}), encoding="utf-16")
    channels = [ChannelName(source=name.split(" ")[0], group=None) for name in PLAIN]
    tracemalloc.start()
    TextTable(path, Csv()).read(channels)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2.0 * path.stat().st_size  # Arrow adds two blocks of 1 MiB


def test_uneven_and_slower_columns_are_interpolated_and_a_gap_is_left_for_a_bundle_to_refuse(tmp_path: Path) -> None:
    uneven = TIME + 0.0016 * np.sin(12 * TIME)
    columns = {"time [s]": uneven, **{name: np.interp(uneven, TIME, column) for name, column in MOVED.items()}}
    made = imported(written(tmp_path, text(columns)))
    assert any("interpolated to" in note for note in made.notes)
    recording = made.sweeps[0].recording
    np.testing.assert_allclose(recording.position, np.interp(recording.time, TIME, WAY), atol=2e-3)
    slow = [f"{one:.9f}" if k % 2 == 0 else "" for k, one in enumerate(WAY)]
    made = imported(written(tmp_path, text({**PLAIN, "phi [rad]": slow})))
    np.testing.assert_allclose(made.sweeps[0].recording.position[:-1], WAY[:-1], atol=1e-4)
    kept = np.delete(np.arange(ROWS), range(200, 203))
    made = imported(written(tmp_path, text({name: column[kept] for name, column in PLAIN.items()})))
    assert float(np.diff(made.sweeps[0].recording.time).max()) == pytest.approx(0.016)


MOTOR = {"M": TORQUE / GEAR, "n": SPEED * GEAR}
IN_DEG, IN_RAD, IN_RPM = {"phi [deg]": np.degrees(WAY)}, {"phi [rad]": WAY}, MOTOR["n"] * RPM
BY_MOTOR = {"M [Nm]": MOTOR["M"], "n [rpm]": IN_RPM}
UNITS: dict[str, tuple[dict[str, Array], dict[str, Any]]] = {
    "deg": ({"M [Nm]": TORQUE, "n [deg/s]": np.degrees(SPEED), **IN_DEG}, {}),
    "°, U/min": ({"M [Nm]": TORQUE, "n [U/min]": SPEED * RPM, "phi [°]": np.degrees(WAY)}, {}),
    "motor rpm": ({"M [Nm]": MOTOR["M"], "n [min-1]": IN_RPM, "phi [Grad]": np.degrees(WAY)}, {"gear_ratio": GEAR}),
    "gear found": ({**BY_MOTOR, "phi [mrad]": WAY * 1e3}, {}),
    "motor against axis": ({"M [Nm]": -MOTOR["M"], "n [rpm]": -IN_RPM, **IN_RAD}, {"gear_ratio": GEAR}),
    "motor turns": ({**BY_MOTOR, "phi [rev]": WAY * GEAR / math.tau}, {"gear_ratio": GEAR}),
    "speed without unit": ({"M [Nm]": TORQUE, "n": np.degrees(SPEED), **IN_DEG}, {}),
    "percent": ({"M [%]": TORQUE / 0.6, "n [rad/s]": SPEED, **IN_RAD}, {"rated_effort": 60.0}),
    "per mille": ({"M [‰]": TORQUE / 0.06, "n [rad/s]": SPEED, **IN_RAD}, {"rated_effort": 60.0}),
    "A": ({"i_q [A]": MOTOR["M"] / 0.9, "n [rpm]": IN_RPM, **IN_DEG}, {"torque_constant": 0.9}),
    "mA": ({"current [mA]": TORQUE / 9e-3, "n [rad/s]": SPEED, **IN_RAD}, {"torque_constant": 9.0}),
    "mNm": ({"tau [mNm]": TORQUE * 1e3, "qd [rad/s]": SPEED, "q [rad]": WAY}, {}),
    "mm": ({"F [kN]": TORQUE / 1e3, "v [mm/min]": SPEED * 6e4, "s [mm]": WAY * 1e3}, {}),
    "m/min": ({"Kraft [N]": TORQUE, "Geschwindigkeit [m/min]": SPEED * 60, "Weg [m]": WAY}, {}),
}


@pytest.mark.parametrize(("columns", "known"), UNITS.values(), ids=UNITS.keys())
def test_units_and_sides(columns: dict[str, Array], known: dict[str, Any], tmp_path: Path) -> None:
    made = shows(imported(written(tmp_path, text({"t [s]": TIME, **columns})), **known), tolerance=1e-3)
    assert made.robot.axes[0].gear_ratio in (1.0, pytest.approx(GEAR, rel=1e-3), pytest.approx(-GEAR, rel=1e-3))
    _, (again,) = import_trace(written(tmp_path, mapping_text(made), "mapping.yaml"))  # what is found is written out
    np.testing.assert_allclose(again.recording.effort, made.sweeps[0].recording.effort)
    np.testing.assert_allclose(again.recording.time, made.sweeps[0].recording.time, atol=1e-9)


Signals = Mapping[str, tuple[str, str, Array, float]]


def line_trace(axes: Mapping[str, Signals], *, family: str = "_V20", sessions: int = 1) -> str:
    """By axis and name: units of set-up and data, values, interval. A value is written when it changes."""
    named = [(axis, *pair) for axis, held in axes.items() for pair in held.items()]
    signals = [(f"f{k}", f"/Nck/!SD/{name} [u1, {axis}]", *one) for k, (axis, name, one) in enumerate(named, start=1)]
    head = "".join(f'<signal key="s{key}" unitsType="{setup}" name="{name}"/>' for key, name, setup, *_ in signals)
    frame = "".join(
        f'<dataSignal key="s{key}" unitsType="{units}" name="{name}" interval="{step:.6f}" id="{key}"/>'
        for key, name, _, units, _, step in signals
    )
    records: list[str] = []
    last: dict[str, str] = {}
    for row, at in enumerate(TIME):
        now = {key: f"{values[row]:.9f}" for key, _, _, _, values, step in signals if row % round(step * RATE) == 0}
        changed = " ".join(f'{key}="{value}"' for key, value in now.items() if last.get(key) != value)
        last |= now
        if changed or row == ROWS - 1:
            records.append(f'<rec time="{at:.6f}" {changed}/>')
    started = '<frameHeader dropOuts="0" startTime="2026-01-15T08:00:00Z"/>'
    data = f"<dataFrame>{started}{frame}{''.join(records)}</dataFrame>"
    return (
        '<?xml version="1.0" encoding="utf-8" ?><traceSession version="01.00"><traceCaptureSetup'
        f"{family}><signalSettings>{head}</signalSettings></traceCaptureSetup{family}>"
        f'<traceData dataFrames="{sessions}">{data * sessions}</traceData></traceSession>'
    )


STEP, SCREW = 1 / RATE, math.tau / 0.01


def rotary(torque: str = "611DTime1") -> Signals:
    return {
        "nckServoDataDrvLoad64": ("percent", "percent", np.abs(TORQUE), 2 * STEP),
        "nckServoDataCmdTorque64": ("torque", torque, TORQUE / GEAR, STEP),
        "nckServoDataActPos2ndEnc64": ("posn", "posn", np.degrees(WAY), STEP),
        "nckServoDataActVelMot64": ("velo", "velo", SPEED * GEAR * RPM, STEP),
        "nckServoDataActVel2ndEnc64": ("velo", "velo", SPEED * RPM, STEP),
        "nckServoDataActCurr64": ("current", "current", TORQUE / GEAR / 0.9, STEP),
    }


def linear(way: Array = WAY, speed: Array = SPEED) -> Signals:
    """Two encoders of different zero; force by a screw."""
    return {
        "nckServoDataCmdPos64": ("posn", "posn", way * 1e3, STEP),
        "nckServoDataActPos1stEnc64": ("posn", "posn", way * 1e3 - 800, STEP),
        "nckServoDataActPos2ndEnc64": ("posn", "posn", way * 1e3, STEP),
        "nckServoDataActVel1stEnc64": ("velo", "velo", speed * 6e4, STEP),
        "nckServoDataActVel2ndEnc64": ("velo", "velo", speed * 6e4, STEP),
        "nckServoDataCtrlDev64": ("posn", "posn", way * 0 + 0.01, STEP),
        "nckServoDataCmdTorque64": ("torque", "611DTime1", TORQUE / SCREW, STEP),
        "nckServoDataActCurr64": ("current", "current", TORQUE / SCREW / 0.9, STEP),
    }


def direct(slides: bool) -> Signals:
    return {
        "nckServoDataCmdTorque64": ("torque", "611DTime1", TORQUE, STEP),
        "nckServoDataActVelMot64": ("velo", "velo", SPEED * (60 if slides else RPM), STEP),
        "nckServoDataActPos1stEnc64": ("posn", "posn", WAY * 1e3 if slides else np.degrees(WAY), STEP),
        "actToolBasePos": ("posn", "posn", WAY * 0 + 7, STEP),
    }


def traced(folder: Path, signals: Signals, **given: Any) -> Imported:
    return imported(written(folder, line_trace({"3": signals}), "trace.xml"), **given)


@pytest.mark.parametrize("family", ["", "_V20"])
@pytest.mark.parametrize("torque", ["torque", "611DTime1"])
def test_solution_line_trace_of_a_rotary_axis(family: str, torque: str, tmp_path: Path) -> None:
    """Nothing but the file: its two speeds tell the gear ratio."""
    made = shows(imported(written(tmp_path, line_trace({"3": rotary(torque)}, family=family), "trace.xml")))
    assert made.robot.axes[0].gear_ratio == pytest.approx(GEAR)
    assert any("0.9 N m per A of i_q" in note for note in made.notes)
    assert any("611DTime1" in note for note in made.notes) == (torque == "611DTime1")


def test_solution_line_trace_of_a_linear_axis_with_two_encoders(tmp_path: Path) -> None:
    made = traced(tmp_path, linear(), gear_ratio=SCREW)
    recording = made.sweeps[0].recording
    np.testing.assert_allclose(recording.position - recording.position[0], WAY - WAY[0], atol=1e-6)
    np.testing.assert_allclose(recording.velocity, SPEED, atol=1e-6)
    np.testing.assert_allclose(recording.effort, TORQUE, atol=1e-3)
    # zeros differ, the motion does not
    np.testing.assert_allclose(cast(Array, recording.load_position), recording.position, atol=1e-6)
    assert made.robot.chain.joints[0].kind == "prismatic"
    with pytest.raises(BadInput, match="is the motor's torque: give the gear ratio as --gear-ratio"):
        imported(tmp_path / "trace.xml")


@pytest.mark.parametrize("slides", [False, True], ids=["torque motor", "linear motor"])
def test_solution_line_trace_of_a_direct_drive(slides: bool, tmp_path: Path) -> None:
    made = shows(traced(tmp_path, direct(slides)))
    assert made.robot.axes[0].gear_ratio == 1.0
    assert made.robot.chain.joints[0].kind == ("prismatic" if slides else "revolute")


def test_a_screw_is_told_from_a_gear_by_its_ratio(tmp_path: Path) -> None:
    signals = {name: one for name, one in linear().items() if "Vel" not in name}
    signals |= {"nckServoDataActVelMot64": ("velo", "velo", SPEED * SCREW * RPM, STEP)}
    made = traced(tmp_path, signals, gear_ratio=SCREW)
    np.testing.assert_allclose(made.sweeps[0].recording.effort, TORQUE, atol=1e-3)
    assert made.robot.chain.joints[0].kind == "prismatic"


def test_sessions_and_axes_of_a_solution_line_trace(tmp_path: Path) -> None:
    still = {name: (*one[:2], one[2] * 0 + 1, one[3]) for name, one in rotary().items()}
    path = written(tmp_path, line_trace({"5": still, "3": rotary()}, sessions=2), "trace.xml")
    assert [sweep.spec.id for sweep in shows(imported(path, axis="3")).sweeps] == ["0001", "0002"]
    with pytest.raises(BadInput, match="has channels of axes 3, 5"):
        imported(path)


def test_an_axis_that_stops_and_steps_by_the_micrometre(tmp_path: Path) -> None:
    """An emergency stop: nothing changes, so that nothing is written; then steps of one increment."""
    stopped = np.where(TIME < 1, WAY, WAY[250]) + 1e-6 * np.floor(np.maximum(TIME - 1.5, 0) * 20)
    jitter = 1e-7 * np.random.default_rng(0).standard_normal(ROWS)  # of the control loop, about the steps
    stopped = stopped + np.where(TIME < 1, 0, jitter)
    speed = np.concatenate([[0.0], np.diff(stopped)]) * RATE  # as the control has it
    recording = traced(tmp_path, linear(stopped, speed), gear_ratio=SCREW).sweeps[0].recording
    np.testing.assert_allclose(recording.position - recording.position[0], stopped - stopped[0], atol=1e-9)
    np.testing.assert_allclose(recording.time, TIME, atol=1e-9)


ROBOT = {"timestamp": TIME + 1e5}  # of several axes, of which one moves
for number, moves in enumerate((0, 0, 1, 0, 0, 0)):
    ROBOT |= {f"actual_q_{number}": WAY if moves else WAY * 0 + number, f"actual_qd_{number}": SPEED * moves}
    ROBOT |= {f"actual_current_{number}": TORQUE / 9 * moves, f"target_moment_{number}": TORQUE * 2}


def test_a_robot_of_several_axes(tmp_path: Path) -> None:
    shows(imported(written(tmp_path, text(ROBOT, " ")), axis="2", torque_constant=9.0))


XML = line_trace({"3": rotary()})
DOCTYPE = '<?xml version="1.0"?><!DOCTYPE a [<!ENTITY b "c">]>' + XML.partition("?>")[2]
TORN = f"\n{TIME[300]:.9f},"
UNKNOWN = r"no channel that is known as effort or position"
REFUSED: dict[str, tuple[str, dict[str, Any], str]] = {
    "letter": (text(PLAIN).replace(TORN, "\nx,"), {}, r"line 302, column 'time': 'x' is not a number"),
    "cells": (text(PLAIN).replace(TORN, "\n"), {}, r"line 302: has 3 cells, the lines before have 4"),
    "no torque": (text({"#time": TIME, "accel_x": SPEED, "accel_y": SPEED}), {}, UNKNOWN),
    "accelerations by frequency": (text({"freq": TIME, "psd_x": SPEED, "psd_y": SPEED}), {}, UNKNOWN),
    "no table": ("<html>no\n", {}, r"has no table of numbers; it begins with '<html>no'"),
    "no time": (text(MOVED), {}, r"has no time: give `sample_rate`"),
    "zip": ("PK\x03\x04", {}, r"is a zip file, as Excel writes it: export it as CSV"),
    "unit": (text(PLAIN, head="t [s],M [Nm],n [rad/s],phi [furlong]"), {}, r"unit 'furlong' of the file is not a unit"),
    "axes": (text(ROBOT, " "), {}, r"has channels of axes 0, 1, 2, 3, 4, 5: choose one by --axis"),
    "axis": (text(ROBOT, " "), {"axis": "7"}, r"has no channel of axis '7'; there are those of 0, 1"),
    "current": (text(ROBOT, " "), {"axis": "2"}, r"'actual_current_2' is in A: give the motor's torque constant"),
    "torn XML": (XML[:9000], {}, "is not a complete XML file"),
    "empty XML": (XML.replace("<rec ", "<reck "), {}, "has no session with records"),
    "letter in XML": (XML.replace('f2="', 'f2="x', 1), {}, "f2 at 0.0 s is 'x"),
    "doctype": (DOCTYPE, {}, "declares a DOCTYPE"),
}


@pytest.mark.parametrize(("content", "known", "told"), REFUSED.values(), ids=REFUSED.keys())
def test_refusals_name_place_value_and_next_step(
    content: str, known: dict[str, Any], told: str, tmp_path: Path
) -> None:
    with pytest.raises(BadInput, match=rf"trace\.csv.*{told}"):
        imported(written(tmp_path, content), **known)


NAMES = {"t": TIME, "q": WAY, "dq": SPEED, "tau": TORQUE}
LOG: dict[str, Any] = {
    name: np.stack([column * 0, column], 1) if name != "t" else column for name, column in NAMES.items()
}


def write_matlab(path: Path, content: Mapping[str, Any], version: str) -> Path:
    if version == "5":
        savemat(path, dict(content))
        return path
    with _h5.File(str(path), "w", userblock_size=512) as file:  # MATLAB writes its arrays with their sides exchanged

        def put(group: Any, name: str, value: Any) -> None:
            if isinstance(value, dict):
                inner = group.create_group(name)
                for key, one in cast("dict[str, Any]", value).items():
                    put(inner, key, one)
            else:
                group[name] = np.atleast_2d(np.asarray(value).T)

        for name, value in content.items():
            put(file, name, value)
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    return path


@pytest.mark.parametrize("version", ["5", "7.3"])
@pytest.mark.parametrize(
    ("content", "axis"),
    [(NAMES, None), (LOG, "1"), ({"log": LOG}, "1"), ({"log": {"joint": NAMES}}, None)],
    ids=["vectors", "matrices", "struct", "nested"],
)
def test_matlab(version: str, content: dict[str, Any], axis: str | None, tmp_path: Path) -> None:
    shows(imported(write_matlab(tmp_path / "trace.mat", content, version), axis=axis))


def test_a_mapping_names_the_column_of_a_matrix(tmp_path: Path) -> None:
    write_matlab(tmp_path / "trace.mat", LOG, "5")

    def mapped_with(position: dict[str, Any]) -> Path:
        named = {"time": {"source": "t"}, "velocity": {"source": "dq[1]"}, "effort": {"source": "tau[1]"}}
        return mapped(tmp_path, "trace.mat", {"position": position, **named})

    for named in ({"source": "q[1]"}, {"source": "q", "column": 1}):
        _, (sweep,) = import_trace(mapped_with(named))
        np.testing.assert_allclose(sweep.recording.position, WAY)
    for source, told in (
        ("q", r"'q': is not a column of numbers: float64 \(500, 2\); give a column, q\[0\] to q\[1\]"),
        ("q[2]", r"'q\[2\]': has columns 0 to 1, not 2"),
    ):
        with pytest.raises(BadInput, match=f"variable {told}"):
            import_trace(mapped_with({"source": source}))


def written_object(folder: Path, version: str, besides: Mapping[str, Any]) -> Path:
    """A timetable beside other variables, as MATLAB saves it: a number in place of its values."""

    def element(kind: int, data: bytes) -> bytes:
        return struct.pack("<II", kind, len(data)) + data + b"\0" * (-len(data) % 8)

    path = write_matlab(folder / "trace.mat", besides, version)
    number = np.array([[0xDD000000, 2, 1, 1, 1, 1]], np.uint32)
    if version == "7.3":
        with _h5.File(str(path), "r+") as file:
            file["tt"] = number
            file["tt"].attrs["MATLAB_class"] = np.bytes_("timetable")
            file["tt"].attrs["MATLAB_object_decode"] = np.int32(3)
        return path
    names = b"".join(element(1, name) for name in (b"tt", b"MCOS", b"timetable"))
    inner = element(6, struct.pack("<II", 13, 0)) + element(5, struct.pack("<ii", 6, 1)) + element(1, b"")
    whole = element(6, struct.pack("<II", 17, 0)) + names + element(14, inner + element(6, number.tobytes()))
    with path.open("ab") as file:
        file.write(element(14, whole))
    return path


@pytest.mark.parametrize("version", ["5", "7.3"])
def test_a_timetable_of_matlab_is_refused_with_the_way_out_and_hides_nothing(version: str, tmp_path: Path) -> None:
    shows(imported(written_object(tmp_path, version, NAMES)))
    told = r"variable 'tt': is an object of MATLAB \(timetable\): write its columns as a struct, s = table2struct"
    with pytest.raises(BadInput, match=told):
        imported(written_object(tmp_path, version, {}))


HALVED = ChannelConversion(conversion_type=2, P1=0.0, P2=1.0, P3=6.0, P4=0.0, P5=0.0, P6=2.0)  # rational, but linear


@pytest.mark.parametrize(
    ("version", "order", "conversion"),
    [
        ("3.00", (0, 1, 2), None),
        ("3.30", (2, 0, 1), None),
        ("4.00", (0, 1, 2), None),
        ("4.10", (0, 1, 2), HALVED),
        ("4.20", (2, 0, 1), None),
    ],
)
def test_mdf(version: Any, order: tuple[int, ...], conversion: ChannelConversion | None, tmp_path: Path) -> None:
    known = (("M_ist", "Nm", TORQUE), ("n_ist", "min-1", SPEED * RPM), ("phi_ist", "Grad", np.degrees(WAY)))
    signals = [
        asammdf.Signal(
            column if conversion is None else 2 * column - 6, TIME, name=name, unit=unit, conversion=conversion
        )
        for name, unit, column in (known[k] for k in order)
    ]
    with asammdf.MDF(version=version) as file:
        file.append(signals, common_timebase=True)
        path = file.save(tmp_path / "trace.bin")
    shows(imported(path))


def test_parquet(tmp_path: Path) -> None:
    write_columns(tmp_path / "trace.parquet", Recording(time=TIME, effort=TORQUE, velocity=SPEED, position=WAY))
    shows(imported(tmp_path / "trace.parquet"))


@pytest.mark.parametrize(
    ("storage", "stamped", "alone"),
    [
        (StoragePlugin.SQLITE3, True, True),
        (StoragePlugin.SQLITE3, False, False),
        (StoragePlugin.MCAP, False, True),
        (StoragePlugin.MCAP, True, False),
    ],
)
def test_ros_bag(storage: StoragePlugin, stamped: bool, alone: bool, tmp_path: Path) -> None:
    """Joint states whose names come in any order; `stamped`, or as recorded; the file `alone`, or its folder."""
    store = get_typestore(Stores.LATEST)
    kind: Any = store.types["sensor_msgs/msg/JointState"]
    header, stamp = (cast(Any, store.types[name]) for name in ("std_msgs/msg/Header", "builtin_interfaces/msg/Time"))
    with Writer(tmp_path / "bag", version=9, storage_plugin=storage) as writer:
        connection = writer.add_connection("/joint_states", kind.__msgtype__, typestore=store)
        for row, at in enumerate(TIME):
            now = 10**18 + round(at * 1e9)
            order = [0, 1] if row % 2 else [1, 0]
            values = [np.array([0.0, column[row]])[order] for column in (WAY, SPEED, TORQUE)]
            said = stamp(sec=now // 10**9, nanosec=now % 10**9) if stamped else stamp(sec=0, nanosec=0)
            message = kind(header(said, "base"), [["shoulder", "elbow"][k] for k in order], *values)
            writer.write(connection, now, store.serialize_cdr(message, kind.__msgtype__))
    path = next(one for one in (tmp_path / "bag").iterdir() if one.suffix != ".yaml") if alone else tmp_path / "bag"
    shows(imported(path, axis="elbow"))
    with pytest.raises(BadInput, match="has channels of axes elbow, shoulder"):
        imported(path)


def joint_states(row: int, at: int) -> dict[str, Any]:
    stamp = {"sec": at // 10**9, "nsec" if row % 2 else "nanosec": at % 10**9}
    names = ["shoulder", "elbow"][:: 1 if row % 3 else -1]
    values = [[0.0 if name == "shoulder" else float(column[row]) for name in names] for column in (WAY, SPEED, TORQUE)]
    measured = dict(zip(("position", "velocity", "effort"), values, strict=True))
    return {"header": {"stamp": stamp}, "name": names, **measured}


def joints_of_foxglove(row: int, at: int) -> dict[str, Any]:
    said = joint_states(row, at)
    fields = ("name", "position", "velocity", "effort")
    rows = zip(*(said[name] for name in fields), strict=True)
    return {"timestamp": said["header"]["stamp"], "joints": [dict(zip(fields, one, strict=True)) for one in rows]}


def one_joint(row: int, at: int) -> dict[str, Any]:
    return {"sweep": "1", "time": at * 1e-9, "effort": TORQUE[row], "velocity": SPEED[row], "position": WAY[row]}


@pytest.mark.parametrize("message", [joint_states, joints_of_foxglove, one_joint])
def test_mcap_of_json(message: Callable[[int, int], dict[str, Any]], tmp_path: Path) -> None:
    path = tmp_path / "trace.mcap"
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start()
        schema = writer.register_schema("any", "jsonschema", b"{}")
        channel, other = (writer.register_channel(name, "json", schema) for name in ("/elbow", "/log"))
        for row, at in enumerate(TIME):
            now = 10**18 + round(at * 1e9)
            writer.add_message(channel, log_time=now, publish_time=now, data=json.dumps(message(row, now)).encode())
            writer.add_message(other, log_time=now, publish_time=now, data=b'{"text": "moves", "name": "node"}')
        writer.finish()
    shows(imported(path, axis="elbow"))
