"""Bundles: round trip, atomic writing, and a named refusal for everything that BUNDLE.md forbids.

Every numeric field of bundle.json and of the URDF with an absurd value: none passes silently.
"""

import copy
import dataclasses
import io
import json
import re
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from pydantic import ValidationError

from service import BadInput
from service.model import (
    Axis,
    Prior,
    Recording,
    Robot,
    RobotDescription,
    Sine,
    Sweep,
    SweepSpec,
    build_robot,
    robot_from_outside,
)
from service.model.counterbalance import Counterbalance
from service.store.files.bundle import Bundle, read_bundle, read_from, write_bundle
from tests.recorded_bundle import bundle

Edit = Callable[[dict[str, Any]], object]


INERTIA = '<inertia ixx="1" iyy="1.2" izz="1.1" ixy="0.01" ixz="0.02" iyz="0.03"/>'

FULL_URDF = f"""<robot name="two">
  <link name="base"><collision><origin xyz="0 0 0.1" rpy="0 0 0.5"/>
    <geometry><box size="0.1 0.2 0.3"/></geometry></collision></link>
  <link name="turn">
    <inertial><origin xyz="0.1 0.2 0.3" rpy="0.1 0.2 0.3"/><mass value="10"/>{INERTIA}</inertial>
    <collision><geometry><cylinder radius="0.1" length="0.4"/></geometry></collision>
  </link>
  <link name="push">
    <inertial><mass value="5"/>{INERTIA}</inertial>
    <collision><geometry><sphere radius="0.2"/></geometry></collision>
  </link>
  <link name="tool"><inertial><mass value="1"/>{INERTIA}</inertial></link>
  <joint name="j1" type="revolute"><parent link="base"/><child link="turn"/><origin xyz="0 0 0.3" rpy="0 0 0"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="1" effort="100"/><dynamics damping="1" friction="2"/>
  </joint>
  <joint name="j2" type="prismatic"><parent link="turn"/><child link="push"/>
    <axis xyz="1 0 0"/><limit lower="0" upper="1" velocity="1" effort="100"/></joint>
  <joint name="flange" type="fixed"><parent link="push"/><child link="tool"/><origin xyz="0.1 0 0" rpy="0 0 0"/></joint>
</robot>
"""

AXES = (
    Axis(joint="j1", gear_ratio=-171.0, motor_inertia=0.0021, rated_effort=2500.0, viscous_friction=2.0,
         cogging_orders=(24.0,), transmission_orders=(1.0,)),
    Axis(joint="j2", gear_ratio=600.0, motor_inertia=0.001, rated_effort=900.0, viscous_friction=150.0,
         speed_gain=900.0),
)  # fmt: skip

ROBOT = RobotDescription(name="two", urdf="robot.urdf", axes=AXES, prior=Prior())


@pytest.fixture
def robot() -> Robot:
    """A turning and a pushing axis."""
    return build_robot(ROBOT, FULL_URDF)


def one_sweep() -> Sweep:
    """j1 for two periods of 1 s at 100 Hz after half a second of settling."""
    spec = SweepSpec(
        id="0001",
        axis="j1",
        pose=(0.1, 0.5),
        offset_velocity=0.01,
        sines=(Sine(frequency=2.0, amplitude=0.002, phase=0.3), Sine(frequency=5.0, amplitude=0.001)),
        period=1.0,
        periods=2,
        measure_from=0.5,
        sample_rate=100.0,
    )
    time = np.arange(250) / 100.0
    return Sweep(spec, Recording(time, np.sin(time), np.cos(time), 0.1 * time, load_velocity=np.cos(3 * time)))


@pytest.fixture
def sweep() -> Sweep:
    return one_sweep()


@pytest.fixture
def folder(tmp_path: Path, robot: Robot, sweep: Sweep) -> Path:
    second = dataclasses.replace(sweep, spec=sweep.spec.model_copy(update={"id": "0002", "repeat": 1}))
    write_bundle(tmp_path / "bundle", robot, [sweep, second])
    return tmp_path / "bundle"


def same(one: Bundle, other: Bundle) -> None:
    assert one.robot == other.robot
    assert [sweep.spec for sweep in one.sweeps] == [sweep.spec for sweep in other.sweeps]
    for ours, theirs in zip(one.sweeps, other.sweeps, strict=True):
        for field in dataclasses.fields(Recording):
            np.testing.assert_array_equal(getattr(ours.recording, field.name), getattr(theirs.recording, field.name))


numbers = st.floats(-1e4, 1e4)


PRINTABLE = st.characters(codec="utf-8", exclude_categories=["Cc"])


@st.composite
def sweeps(draw: st.DrawFn) -> list[Sweep]:
    drawn: list[Sweep] = []
    for name in draw(st.lists(st.text(PRINTABLE, min_size=1, max_size=8), min_size=1, max_size=3, unique=True)):
        rate = draw(st.sampled_from([50.0, 400.0]))
        lines = draw(st.lists(st.integers(1, 20), unique=True, max_size=3))
        periods = draw(st.integers(1, 3)) if lines else None
        count = int(rate * (periods or 1)) + draw(st.integers(1, 40))
        spec = SweepSpec(
            id=name,
            axis=draw(st.sampled_from(["j1", "j2"])),
            pose=(draw(numbers), draw(numbers)),
            offset_velocity=draw(numbers),
            excitation=draw(st.sampled_from(["multisine", "noise", "trajectory", "standstill"])),
            sines=tuple(
                Sine(frequency=float(line), amplitude=abs(draw(numbers)), phase=draw(numbers)) for line in lines
            ),
            period=1.0 if lines else None,
            periods=periods,
            sample_rate=rate,
            started_at=draw(numbers),
            repeat=draw(st.integers(0, 5)),
            block=draw(st.text(PRINTABLE, max_size=5)),
        )
        columns = [np.full(count, draw(numbers)) for _ in range(3)]
        drawn.append(Sweep(spec, Recording(np.arange(count) / rate, *columns)))
    return drawn


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(drawn=sweeps())
def test_round_trip(tmp_path_factory: pytest.TempPathFactory, robot: Robot, drawn: list[Sweep]) -> None:
    folder = tmp_path_factory.mktemp("bundles") / "new" / "bundle"
    write_bundle(folder, robot, drawn)
    same(read_bundle(folder), Bundle(robot, tuple(drawn)))
    assert [path.name for path in folder.parent.iterdir()] == ["bundle"]


def test_an_empty_directory_is_filled_and_a_full_one_left_alone(tmp_path: Path, robot: Robot, sweep: Sweep) -> None:
    folder = tmp_path / "bundle"
    folder.mkdir()
    write_bundle(folder, robot, [sweep])
    assert len(read_bundle(folder).sweeps) == 1
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    with pytest.raises(BadInput, match="not an empty folder"):
        write_bundle(folder, robot, [sweep])
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


def test_what_cannot_be_read_is_not_written(tmp_path: Path, robot: Robot, sweep: Sweep) -> None:
    torn = dataclasses.replace(sweep.recording, effort=np.full(sweep.recording.time.size, np.nan))
    for bad in ([], [sweep, sweep], [sweep, Sweep(sweep.spec.model_copy(update={"id": "b"}), torn)]):
        with pytest.raises(BadInput):
            write_bundle(tmp_path / "bundle", robot, bad)
        assert list(tmp_path.iterdir()) == []


def change(folder: Path, edit: Edit) -> None:
    path = folder / "bundle.json"
    document = json.loads(path.read_text())
    edit(document)
    path.write_text(json.dumps(document))


def first(update: dict[str, object]) -> Edit:
    return lambda document: document["sweeps"][1].update(update)


SWEEP = "bundle.json sweep 0002"


FILE = "0002.parquet sweep 0002"


@pytest.mark.parametrize(
    ("edit", "place", "reason"),
    [
        (lambda d: d.update(format="sweepid-bundle/2"), "bundle.json format", "Input should be"),
        (lambda d: d.pop("robot"), "bundle.json robot", "Field required"),
        (lambda d: d.update(sweps=[]), "bundle.json sweps", "Extra inputs are not permitted"),
        (lambda d: d.update(sweeps=[]), "bundle.json", "has no sweeps"),
        (lambda d: d["robot"]["axes"][0].update(gear=1), "bundle.json robot.axes.0.gear", "Extra inputs"),
        (lambda d: d["robot"]["axes"].reverse(), "bundle.json robot.axes", "differ from the URDF's moving joints"),
        (lambda d: d["robot"]["axes"].pop(), "bundle.json robot.axes", "differ from the URDF's moving joints"),
        (lambda d: d["robot"].update(urdf="other.urdf"), "other.urdf", "cannot be read: No such file"),
        (lambda d: d["robot"].update(urdf="sweeps/0001.parquet"), "0001.parquet", "cannot be read"),
        (lambda d: d["robot"].update(urdf="../bundle.urdf"), "bundle.json robot.urdf", "outside of the bundle"),
        (first({"id": "0001"}), "bundle.json sweep 0001", "another sweep has the same id"),
        (first({"id": ""}), "bundle.json sweeps.1.id", "at least 1 character"),
        (first({"axis": "j3"}), SWEEP, "unknown joint 'j3'; robot two has j1, j2"),
        (first({"pose": [0.0]}), SWEEP, "pose has 1 numbers, robot two has 2 axes"),
        (first({"pose": [0.0, "0"]}), "bundle.json sweeps.1.pose.1", "valid number, got '0'"),
        (first({"pose": [0.0, float("nan")]}), "bundle.json sweeps.1.pose.1", "finite number"),
        (first({"sample_rate": 0}), "bundle.json sweeps.1.sample_rate", "greater than 0"),
        (first({"sample_rate": 99.0}), FILE, "sample_rate is 99 Hz, but time runs at 100 Hz"),
        (first({"sample_rate": 1000.0}), FILE, "gap in time: 0.01 s follows 0 s"),
        (first({"sample_rate": 1e308}), "bundle.json sweeps.1.sample_rate", "less than or equal to 1000000"),
        (first({"sample_rate": 1e6, "sines": []}), FILE, "gap in time"),
        (first({"periods": 3}), FILE, "measured window 0.5 to 3.5 s lies outside of the record of 2.5 s"),
        (first({"measure_from": 0.52}), FILE, "measured window 0.52 to 2.52 s"),
        (first({"periods": None}), SWEEP, "period is 1.0 but periods is None"),
        (first({"period": 0.7, "periods": 2}), SWEEP, "sine of 2 Hz makes 1.4 turns in a period of 0.7 s"),
        (first({"periods": 1, "sample_rate": 100.4}), SWEEP, "1 periods of 1.0 s are not whole samples at 100.4 Hz"),
        (first({"sines": [{"frequency": 50.0, "amplitude": 1}]}), SWEEP, "50 Hz is not below half the sample rate"),
        (first({"sines": [{"frequency": 2, "amplitude": 1}] * 2}), SWEEP, "two sines of 2 Hz"),
        (first({"file": "sweeps/0003.parquet"}), "0003.parquet sweep 0002", "file does not exist"),
        (first({"file": "../0002.parquet"}), SWEEP, "'../0002.parquet' lies outside of the bundle"),
        (first({"file": "/etc/passwd"}), SWEEP, "outside of the bundle"),
        (first({"file": "bundle.json"}), "bundle.json sweep 0002", "a file of samples must be .parquet or .csv"),
        (first({"file": "a\0.csv"}), SWEEP, "is not valid"),
        (first({"file": None}), "bundle.json sweeps.1.file", "valid string"),
    ],
)
def test_refusals_name_file_sweep_and_reason(folder: Path, edit: Edit, place: str, reason: str) -> None:
    change(folder, edit)
    with pytest.raises(BadInput) as refusal:
        read_bundle(folder)
    assert refusal.value.place.endswith(place)
    assert reason in refusal.value.reason
    assert "\n" not in str(refusal.value)


def test_a_link_out_of_the_bundle_is_not_followed(folder: Path) -> None:
    outside = folder.parent / "outside.parquet"
    (folder / "sweeps/0002.parquet").rename(outside)
    (folder / "sweeps/0002.parquet").symlink_to(outside)
    with pytest.raises(BadInput, match="outside of the bundle"):
        read_bundle(folder)


@pytest.mark.parametrize(
    "text",
    ["", "{", "[]", "null", "[" * 100_000, '{"format": NaN}', "\ufeff{}", '{"a": ' + "9" * 5000 + "}", '"\\ud800"'],
)
def test_what_is_no_json_object(folder: Path, text: str) -> None:
    (folder / "bundle.json").write_text(text)
    with pytest.raises(BadInput, match=r"bundle\.json"):
        read_bundle(folder)


def test_a_bundle_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="No such file"):
        read_bundle(tmp_path / "bundle")


def paths(value: Any, here: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [here, *(path for key, child in inner for path in paths(child, (*here, key)))]


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=6) | st.just(10**400),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=6), inner, max_size=3),
    max_leaves=5,
)


@pytest.mark.slow
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_mutation_is_read_or_refused(folder: Path, data: st.DataObject) -> None:
    """The document with up to three of its values replaced: a bundle or a `BadInput`, never anything else."""
    path = folder / "bundle.json"
    intact = path.read_text()
    document = json.loads(intact)
    for _ in range(data.draw(st.integers(1, 3))):
        *parents, last = data.draw(st.sampled_from(paths(document)[1:]))
        parent = document
        for key in parents:
            parent = parent[key]
        parent[last] = copy.deepcopy(data.draw(json_values))
        if len(paths(document)) < 2:
            break
    path.write_text(json.dumps(document))
    try:
        outcome: object = read_bundle(folder)
    except BadInput as refusal:
        outcome = refusal
    finally:
        path.write_text(intact)
    assert isinstance(outcome, Bundle | BadInput)


def test_the_sweeps_of_a_bundle_are_counted_together(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.store.files.bundle.MOST_IN_BUNDLE", 2 * 250 * 5 - 1)
    with pytest.raises(BadInput, match=r"bundle\.json: its sweeps contain more than 2499 numbers in total"):
        read_bundle(folder)


@pytest.mark.parametrize("name", ["x" * 201, "a\nb", "a\x1b[31m", ""])
@pytest.mark.parametrize("field", ["id", "axis"])
def test_names_are_short_and_printable(sweep: Sweep, field: str, name: str) -> None:
    with pytest.raises(ValidationError):
        SweepSpec.model_validate(sweep.spec.model_dump() | {field: name})


def archive(*names: str, kind: int = zipfile.ZIP_STORED) -> bytearray:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", kind) as made:
        for name in names:
            made.writestr(name, "{}")
    return bytearray(content.getvalue())


def with_a_dictionary_of_4_gib() -> bytearray:
    """LZMA: its size stands in the member itself and was allocated."""
    content = archive("bundle.json", kind=zipfile.ZIP_LZMA)
    properties = content.index(b"bundle.json") + len("bundle.json") + 4
    content[properties + 1 : properties + 5] = b"\xff\xff\xff\xff"
    return content


def of_3_gib_each() -> bytearray:
    content = archive("a", "b")
    for at in (at for at in range(len(content)) if content[at : at + 4] == b"PK\x01\x02"):
        content[at + 24 : at + 28] = (3 * 2**30).to_bytes(4, "little")  # when unpacked
    return content


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (with_a_dictionary_of_4_gib, r"bundle 'bundle\.json': is compressed by method 14 of zip, which is not read"),
        (lambda: archive(*map(str, range(20_001))), "bundle: has 20001 files, limit 20000"),
        (of_3_gib_each, f"unpacks to {6 * 2**30} bytes, limit {4 * 2**30} bytes"),
    ],
    ids=["memory", "files", "bytes"],
)
def test_an_archive_that_wants_too_much_is_refused(tmp_path: Path, content: Callable[[], bytearray], told: str) -> None:
    (tmp_path / "bundle.zip").write_bytes(content())
    with pytest.raises(BadInput, match=told):
        read_from(tmp_path / "bundle.zip", tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["bundle.json", "b/bundle.json", "b\\bundle.json"])
def test_a_bundle_is_found_in_the_folder_that_was_zipped(tmp_path: Path, name: str) -> None:
    write_bundle(tmp_path / "given", bundle().robot, bundle().sweeps)
    with zipfile.ZipFile(tmp_path / "bundle.zip", "w") as made:
        for path in (tmp_path / "given").rglob("*.*"):
            inside = name.replace("bundle.json", str(path.relative_to(tmp_path / "given")))
            made.writestr(inside.replace("/", "\\") if "\\" in name else inside, path.read_bytes())
    assert read_from(tmp_path / "bundle.zip", tmp_path / "out").robot.joints == bundle().robot.joints


ABSURD = ("NaN", "Infinity", "-Infinity", "1e308", "-1e308", "1e14", "-1e14")


@pytest.fixture(scope="module")
def full(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bundle with a value in every numeric field of the schema."""
    full = tmp_path_factory.mktemp("absurd") / "bundle"
    strut = Counterbalance(anchor=(0.3, 0, 0.9), attachment=(0.1, 0, 0.2), force=500, length=0.4, rate=1e3, column=0.9)
    axes = (AXES[0].model_copy(update={"counterbalance": strut}), *AXES[1:])
    robot = ROBOT.model_copy(update={"axes": axes})
    write_bundle(full, build_robot(robot, FULL_URDF), [one_sweep()])
    return full


def refusal(read: Callable[[], object]) -> str:
    """Place and reason; empty if it passes."""
    try:
        read()
    except BadInput as error:
        return f"{error.place}: {error.reason}"
    return ""


def number_paths(value: Any, path: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """Paths of all numbers."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from number_paths(inner, (*path, key))
    elif isinstance(value, list):
        for number, inner in enumerate(value):
            yield from number_paths(inner, (*path, number))
    elif isinstance(value, int | float):
        yield path


def schema_numbers(schema: dict[str, Any], name: str) -> set[str]:
    """Names of all fields of a model and its parts that hold numbers."""
    found: set[str] = set()
    for part in (schema, *schema.get("$defs", {}).values()):
        for field, entry in part.get("properties", {}).items():
            if re.search(r'"type": "(number|integer)"', json.dumps(entry)):
                found.add(field)
    assert found, name
    return found


def test_the_bundle_has_every_numeric_field_of_the_schema(full: Path) -> None:
    document = json.loads((full / "bundle.json").read_text())
    named = {str(next(key for key in reversed(path) if isinstance(key, str))) for path in number_paths(document)}
    wanted = schema_numbers(SweepSpec.model_json_schema(), "sweep")
    wanted |= schema_numbers(RobotDescription.model_json_schema(), "robot")
    assert wanted <= named


def test_no_absurd_number_of_bundle_json_passes(full: Path) -> None:
    place = full / "bundle.json"
    original = place.read_text()
    document = json.loads(original)
    passed: list[tuple[object, str]] = []
    try:
        for path in number_paths(document):
            for value in ABSURD:
                changed = copy.deepcopy(document)
                target = changed
                for key in path[:-1]:
                    target = target[key]
                target[path[-1]] = "ABSURD"
                place.write_text(json.dumps(changed).replace('"ABSURD"', value))
                if str(place) not in refusal(lambda: read_bundle(full)):
                    passed.append((path, value))
    finally:
        place.write_text(original)
    assert passed == []


ATTRIBUTES = [
    (found.start(2) + number.start(), found.start(2) + number.end(), found[1])
    for found in re.finditer(r'(\w+)="([-0-9. e]+)"', FULL_URDF)
    for number in re.finditer(r"[-0-9.e]+", found[2])
]


@pytest.mark.parametrize("value", [*ABSURD, "nan", "inf"])
def test_no_absurd_number_of_a_urdf_passes(value: str) -> None:
    assert robot_from_outside(ROBOT, FULL_URDF).joints == ("j1", "j2")
    passed: list[str] = []
    for start, end, name in ATTRIBUTES:
        text = FULL_URDF[:start] + value + FULL_URDF[end:]
        if "urdf" not in refusal(lambda text=text: robot_from_outside(ROBOT, text)).lower():
            passed.append(f"{name} at {start}")
    assert passed == []


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        ('<mass value="5"/>', '<mass value="-5"/>', "link push mass value"),
        ('<mass value="1"/>', '<mass value="-1"/>', "link tool mass value"),  # fixed to a link of 5 kg
        ('ixx="1" iyy="1.2"', 'ixx="-1" iyy="1.2"', "link turn"),
        ('velocity="1"', 'velocity="-1"', "joint j1 limit velocity"),
        ('radius="0.1"', 'radius="-0.1"', "link turn cylinder radius"),
        ('ixy="0.01"', 'ixy="5"', "link turn"),  # not positive definite
    ],
)
def test_a_body_that_cannot_exist_is_refused_with_file_place_and_value(
    full: Path, old: str, new: str, place: str
) -> None:
    file = full / "robot.urdf"
    try:
        file.write_text(FULL_URDF.replace(old, new, 1))
        with pytest.raises(BadInput) as bad:
            read_bundle(full)
    finally:
        file.write_text(FULL_URDF)
    assert str(full) in bad.value.place
    assert place in bad.value.place
    assert re.search(r"limit|principal inertias", bad.value.reason)


@pytest.mark.parametrize(
    ("mass", "inertia"),
    [
        (0, INERTIA),
        (0, '<inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/>'),
        (5, '<inertia ixx="1" iyy="0.5" izz="0.4999" ixy="0" ixz="0" iyz="0"/>'),
    ],
)
def test_a_placeholder_without_mass_and_the_rounding_of_a_maker_are_read(mass: int, inertia: str) -> None:
    robot_from_outside(ROBOT, FULL_URDF.replace(f'<mass value="5"/>{INERTIA}', f'<mass value="{mass}"/>{inertia}'))


@pytest.mark.parametrize("column", ["effort", "velocity", "position"])
def test_samples_beyond_any_machine_are_refused(full: Path, tmp_path: Path, column: str) -> None:
    bundle = read_bundle(full)
    (sweep,) = bundle.sweeps
    getattr(sweep.recording, column)[7] = -1e14
    with pytest.raises(BadInput, match=rf"column '{column}' is -1e\+14 in row 8; limit "):
        write_bundle(tmp_path / "again", bundle.robot, [sweep])
