"""The files that fuzzing starts from: those of `config`, data beside the repository where it is there, and what the
product writes itself. The same each time."""

import csv
import functools
import io
import json
import shutil
import struct
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, cast

import numpy as np
import pyarrow as pa

import sweepid
from service.identification.design.excitation import Excitation, way
from service.model import Sine, Sweep
from service.model.configuration import read_cell, read_robot
from service.planning.plan import PlanRequest, build_plan
from service.store.back_up import Manifest, StoredFile
from service.store.files.bundle import write_bundle
from tests.control_file import Loop, tuning_xml
from tests.rigid_sweep import rigid_sweep

ROOT = Path(__file__).resolve().parents[2]
CONFIG = ROOT / "config"
DATA = (ROOT.parent / "shared/data", ROOT.parents[1] / "shared/data")
LARGEST = 250_000  # bytes of a file; a larger one is fuzzed as well, but seldom reached where it matters


@dataclass(frozen=True)
class Seed:
    """Files by path in a folder. `entry` is what the parser is given, `targets` are edited, one a case."""

    files: dict[str, bytes]
    entry: str
    targets: tuple[str, ...]


def stored(name: str) -> Seed:
    """A document as a command wrote it."""
    return one(f"{name}.json", (ROOT / "tests/stored" / f"{name}.json").read_bytes())


def of_config(entry: str, *others: str, targets: tuple[str, ...] = ()) -> Seed:
    """A file of `config` and those that it needs, at the same places to each other; all are edited if none is told."""
    names = (entry, *others)
    return Seed({name: (CONFIG / name).read_bytes() for name in names}, entry, targets or names)


def one(name: str, content: bytes | str) -> Seed:
    return Seed({name: content.encode() if isinstance(content, str) else content}, name, (name,))


def shared(pattern: str) -> Iterator[Seed]:
    """Files of the data beside the repository."""
    for folder in DATA:
        for path in sorted(folder.glob(pattern)):
            if path.stat().st_size <= LARGEST:
                yield one(path.name, path.read_bytes())


def sweep(number: int) -> Sweep:
    """A short one: what is edited should not be large."""
    return rigid_sweep(number, 0.1 * number, rate=50.0, periods=2)


def columns(number: int = 1) -> dict[str, np.ndarray]:
    recording = sweep(number).recording
    return {name: getattr(recording, name) for name in ("time", "effort", "velocity", "position")}


def as_csv(table: dict[str, np.ndarray]) -> bytes:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table)
    writer.writerows(zip(*(values.tolist() for values in table.values()), strict=True))
    return text.getvalue().encode()


def as_stream(table: dict[str, np.ndarray]) -> bytes:
    """As the recorder writes it: two batches, no end mark."""
    arrow, out = cast(Any, pa), io.BytesIO()
    index = np.arange(len(table["time"]))
    batches = [{"index": index[part]} | {k: v[part] for k, v in table.items()} for part in (index < 40, index >= 40)]
    first = arrow.RecordBatch.from_pydict(batches[0])
    writer = arrow.ipc.new_stream(out, first.schema)
    writer.write_batch(first)
    writer.write_batch(arrow.RecordBatch.from_pydict(batches[1]))
    return out.getvalue()


@functools.cache
def bundle() -> Seed:
    """Two sweeps, one as Parquet and one as CSV."""
    with TemporaryDirectory() as folder:
        place = Path(folder) / "bundle"
        write_bundle(place, read_robot(CONFIG / "robots/max100-class.yaml"), [sweep(1), sweep(2)])
        files = {path.relative_to(place).as_posix(): path.read_bytes() for path in place.rglob("*") if path.is_file()}
    document = json.loads(files["bundle.json"])
    document["sweeps"][1]["file"] = "sweeps/0002.csv"
    del files["sweeps/0002.parquet"]
    files |= {"bundle.json": json.dumps(document).encode(), "sweeps/0002.csv": as_csv(columns(2))}
    return Seed(dict(sorted(files.items())), "", tuple(sorted(files)))


def packed(seed: Seed) -> Seed:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for name, content in seed.files.items():
            archive.writestr(zipfile.ZipInfo(name), content, zipfile.ZIP_DEFLATED)
    return one("bundle.zip", out.getvalue())


@functools.cache
def estimate() -> bytes:
    """As `sweepid identify --json` writes it."""
    with TemporaryDirectory() as folder:
        write_bundle(
            Path(folder) / "b", read_robot(CONFIG / "robots/max100-class.yaml"), [sweep(number) for number in (1, 2, 3)]
        )
        return json.dumps(sweepid.identify(Path(folder) / "b").as_json()).encode()


@functools.cache
def plan() -> bytes:
    """As `sweepid plan --out` writes it."""
    request = PlanRequest(robot_id=1, cell="workshop", axes=("joint_3",), varied=("joint_3",), step=30, poses=2)
    document = build_plan(
        read_robot(CONFIG / "robots/max100-class.yaml"), request, read_cell(CONFIG / "cells/workshop.yaml")
    )
    return json.dumps({"id": 7, "document": document.model_dump(mode="json")}).encode()


def manifest() -> str:
    """Of a backup."""
    file = StoredFile(size=3, sha256="0" * 64)
    return Manifest(
        made_at=datetime(2026, 11, 24, tzinfo=UTC),
        schema_version="0012",
        database="1" * 32,
        files={"sweepid.sqlite": file, "recordings/campaign-000001/0001-1.parquet": file},
        streams_left_out=("recordings/campaign-000001/0002-1.arrow",),
        in_store={"recordings/campaign-000001/0003-1.parquet": "2" * 64},
    ).model_dump_json()


TRACE_MAPPING = """robot:
  {name: one, joint: c, kind: revolute, inertia: 4.0, lower: -3, upper: 3, velocity: 1, rated_effort: 50}
axes: {c: {name: C1, direction: -1, zero: 90.0}}
columns:
  time: {source: time}
  effort: {source: effort, scale: 2.0}
  velocity: {from_position: 10}
  position: {source: position, unit: axis position}
  velocity_setpoint: {source: velocity, unit: motor rev/min}
csv: {delimiter: ",", decimal_point: ".", skip_rows: 0}
sweeps:
  - {source: trace.csv, id: "0001", axis: c, pose: [0.0], offset_velocity: 0.0, excitation: trajectory, sample_rate: 50}
"""
ALIGNED = """robot:
  {name: one, joint: c, kind: revolute, inertia: 4.0, lower: -3, upper: 3, velocity: 1, rated_effort: 50}
columns:
  time: {source: time}
  effort: {source: effort}
  velocity: {from_position: 10}
  position: {source: position}
  set_position: {source: position}
csv: {delimiter: ";", decimal_point: ",", skip_rows: 0}
sweeps:
  - {source: trace.csv, id: "0001", axis: c, pose: [0.0], offset_velocity: 0.05, sample_rate: 50, period: 0.5,
     periods: 2, sines: [{frequency: 2.0, amplitude: 0.1, phase: 0.0}], path: {ramp: 0.5, settle: 0.5}}
"""


def aligned_trace() -> bytes:
    """The path of that sweep, half a second after the trace began; a German CSV."""
    path = Excitation(0.05, (Sine(frequency=2.0, amplitude=0.1, phase=0.0),), 0.5, 2, 0.5, 0.5)
    time = np.arange(round(50 * (path.duration + 1))) / 50
    table = {"time": time, "effort": np.cos(time), "position": way(path, time - 0.5)}
    return as_csv(table).replace(b",", b";").replace(b".", b",")


def traces() -> Iterator[Seed]:
    targets = ("mapping.yaml", "trace.csv")
    yield Seed({"mapping.yaml": TRACE_MAPPING.encode(), "trace.csv": as_csv(columns())}, "mapping.yaml", targets)
    yield Seed({"mapping.yaml": ALIGNED.encode(), "trace.csv": aligned_trace()}, "mapping.yaml", targets)


LINE_TRACE = (
    '<?xml version="1.0"?><traceSession><traceCaptureSetup><signal unitsType="torque" name="CmdTorque64 [u1, 1]"/>'
    '</traceCaptureSetup><traceData><dataFrame><frameHeader dropOuts="0"/>'
    '<dataSignal id="f1" unitsType="posn" name="ActPos1stEnc64 [u1, 1]" interval="0.02"/>'
    '<dataSignal id="f2" unitsType="velo" name="ActVelMot64 [u1, 1]" interval="0.02"/>'
    '<dataSignal id="f3" unitsType="611DTime1" name="CmdTorque64 [u1, 1]" interval="0.04"/>{}</dataFrame></traceData>'
    "</traceSession>"
)


def traces_alone() -> Iterator[Seed]:
    """A table with units and stamps of a wall clock, one of TwinCAT's Scope, and a trace of a Solution Line."""
    time = np.arange(100) / 50
    rows = [(at, np.cos(at), 9.5 * np.sin(at), np.degrees(1 - np.cos(at))) for at in time]
    lines = [f"15.01.2026 08:00:{at:06.3f};" + f"{m:.4f};{n:.4f};{phi:.4f}".replace(".", ",") for at, m, n, phi in rows]
    yield one("a.csv", "\n".join(["Zeit;M;n;phi", ";Nm;1/min;°", *lines]))
    pairs = "\n".join(f"{1000 * at}\t{m}\t{1000 * at}\t{n}\t{1000 * at}\t{phi}" for at, m, n, phi in rows)
    head = "\n".join(
        "\t".join(f"{key}\t{one}" for one in of)
        for key, of in (("Name", ["M", "n", "phi"]), ("Unit", ("Nm", "rpm", "deg")))
    )
    yield one("b.csv", f"Name\tx\n\n{head}\n\n{pairs}\nEOF")
    records = "".join(f'<rec time="{at}" f1="{phi}" f2="{n}" f3="{m}"/>' for at, m, n, phi in rows)
    yield one("c.xml", LINE_TRACE.format(records))


def controls() -> Iterator[Seed]:
    yield one("response.xml", Loop().xml())
    yield one("tuning.xml", tuning_xml())
    yield from shared("sinumerik/*.xml")


MAKERS = """<robot name="arm"><link name="base"/>
<joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><origin xyz="0 0 0.3" rpy="0 0 0.1"/>
<axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="100"/><dynamics damping="3"/></joint>
<link name="arm"><inertial><origin xyz="0.1 0 0"/><mass value="5"/>
<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial>
<collision><geometry><mesh filename="package://arm/a.stl" scale="1 1 2"/></geometry></collision>
<collision><origin xyz="0 0 1"/><geometry><mesh filename="package://arm/b.stl"/></geometry></collision></link>
<joint name="lift" type="continuous"><parent link="arm"/><child link="tip"/><axis xyz="0 1 0"/>
<limit velocity="1" effort="9"/></joint>
<link name="tip"><collision><geometry><mesh filename="package://arm/c.obj"/></geometry></collision>
<collision><geometry><mesh filename="package://arm/d.dae"/></geometry></collision>
<collision><geometry><box size="1 2 3"/></geometry></collision>
<collision><geometry><cylinder radius="0.1" length="2"/></geometry></collision>
<collision><geometry><sphere radius="0.1"/></geometry></collision></link>
<joint name="hand" type="fixed"><parent link="tip"/><child link="flange"/></joint><link name="flange"/>
<joint name="finger" type="prismatic"><parent link="flange"/><child link="f"/><axis xyz="1 0 0"/>
<limit lower="0" upper="0.1" velocity="1" effort="5"/></joint><link name="f"/>
<joint name="mate" type="prismatic"><parent link="flange"/><child link="g"/><axis xyz="1 0 0"/><mimic joint="finger"/>
<limit lower="0" upper="0.1" velocity="1" effort="5"/></joint><link name="g"/>
<transmission name="t"><joint name="turn"/><actuator name="m"><mechanicalReduction>100</mechanicalReduction></actuator>
</transmission></robot>"""
_CORNERS = ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1))
_FACES = ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3))
COLLADA = """<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit meter="0.01"/></asset>
<library_geometries><geometry id="g"><mesh><source id="s">
<float_array id="f" count="12">0 0 0 1 0 0 0 1 0 0 0 1</float_array>
<technique_common><accessor source="#f" count="4" stride="3"/></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#s"/></vertices>
<triangles count="4"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2 0 1 3 0 2 3 1 2 3</p></triangles>
</mesh></geometry>
</library_geometries><library_visual_scenes><visual_scene id="scene"><node id="n"><translate>1 0 0</translate>
<rotate>0 0 1 90</rotate><scale>1 1 1</scale><matrix>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</matrix>
<instance_geometry url="#g"/><node id="m"><instance_geometry url="#g"/></node><instance_node url="#m"/></node>
</visual_scene>
</library_visual_scenes><scene><instance_visual_scene url="#scene"/></scene></COLLADA>"""


def maker() -> Seed:
    triangles = [[_CORNERS[k] for k in face] for face in _FACES]
    binary = b"\0" * 80 + struct.pack("<I", 4)
    binary += b"".join(struct.pack("<12fH", 0, 0, 0, *np.ravel(triangle), 0) for triangle in triangles)
    text = "solid x\n" + "".join(f"vertex {x} {y} {z}\n" for one in triangles for x, y, z in one) + "endsolid x\n"
    obj = "".join(f"v {x} {y} {z}\n" for x, y, z in _CORNERS) + "f 1 2 3\nf 1 2 4\n"
    files = {
        "arm/arm.urdf": MAKERS.encode(),
        "arm/a.stl": binary,
        "arm/b.stl": text.encode(),
        "arm/c.obj": obj.encode(),
        "arm/d.dae": COLLADA.encode(),
    }
    return Seed(files, "arm/arm.urdf", ("arm/arm.urdf", *files))


def write_into(folder: Path, files: Mapping[str, bytes]) -> None:
    """The files of a case, and nothing else, in a folder."""
    shutil.rmtree(folder, ignore_errors=True)
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
