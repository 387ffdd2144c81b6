"""Every numeric field of bundle.json and of the URDF, with an absurd value: none passes silently."""

import copy
import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from service.model.errors import BadInput
from service.model.recording import Recording, Sine, Sweep, SweepSpec
from service.model.robot import Axis, Prior, RobotDescription, build_robot, robot_from_outside
from service.store.files.bundle import read_bundle, write_bundle

ABSURD = ("NaN", "Infinity", "-Infinity", "1e308", "-1e308", "1e14", "-1e14")
INERTIA = '<inertia ixx="1" iyy="1.2" izz="1.1" ixy="0.01" ixz="0.02" iyz="0.03"/>'
URDF = f"""<robot name="two">
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
    Axis(joint="j2", gear_ratio=600.0, motor_inertia=0.001, rated_effort=900.0, viscous_friction=150.0),
)  # fmt: skip
ROBOT = RobotDescription(name="two", urdf="robot.urdf", axes=AXES, prior=Prior())


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bundle with a value in every numeric field of the schema."""
    spec = SweepSpec(
        id="0001", axis="j1", pose=(0.1, 0.5), offset_velocity=0.01, sines=(Sine(frequency=2.0, amplitude=0.002),),
        period=1.0, periods=2, measure_from=0.5, sample_rate=100.0,
    )  # fmt: skip
    time = np.arange(250) / 100.0
    folder = tmp_path_factory.mktemp("absurd") / "bundle"
    sweep = Sweep(spec, Recording(time, np.sin(time), np.cos(time), 0.1 * time))
    write_bundle(folder, build_robot(ROBOT, URDF), [sweep])
    return folder


def refusal(read: Callable[[], object]) -> str:
    """Place and reason; empty if it passes."""
    try:
        read()
    except BadInput as error:
        return f"{error.place}: {error.reason}"
    return ""


def numbers(value: Any, path: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """Paths of all numbers."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from numbers(inner, (*path, key))
    elif isinstance(value, list):
        for number, inner in enumerate(value):
            yield from numbers(inner, (*path, number))
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


def test_the_bundle_has_every_numeric_field_of_the_schema(folder: Path) -> None:
    document = json.loads((folder / "bundle.json").read_text())
    named = {str(next(key for key in reversed(path) if isinstance(key, str))) for path in numbers(document)}
    wanted = schema_numbers(SweepSpec.model_json_schema(), "sweep")
    wanted |= schema_numbers(RobotDescription.model_json_schema(), "robot")
    assert wanted <= named


def test_no_absurd_number_of_bundle_json_passes(folder: Path) -> None:
    place = folder / "bundle.json"
    original = place.read_text()
    document = json.loads(original)
    passed: list[tuple[object, str]] = []
    try:
        for path in numbers(document):
            for value in ABSURD:
                changed = copy.deepcopy(document)
                target = changed
                for key in path[:-1]:
                    target = target[key]
                target[path[-1]] = "ABSURD"
                place.write_text(json.dumps(changed).replace('"ABSURD"', value))
                if str(place) not in refusal(lambda: read_bundle(folder)):
                    passed.append((path, value))
    finally:
        place.write_text(original)
    assert passed == []


ATTRIBUTES = [
    (found.start(2) + number.start(), found.start(2) + number.end(), found[1])
    for found in re.finditer(r'(\w+)="([-0-9. e]+)"', URDF)
    for number in re.finditer(r"[-0-9.e]+", found[2])
]


@pytest.mark.parametrize("value", [*ABSURD, "nan", "inf"])
def test_no_absurd_number_of_a_urdf_passes(value: str) -> None:
    assert robot_from_outside(ROBOT, URDF).joints == ("j1", "j2")
    passed: list[str] = []
    for start, end, name in ATTRIBUTES:
        text = URDF[:start] + value + URDF[end:]
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
    folder: Path, old: str, new: str, place: str
) -> None:
    file = folder / "robot.urdf"
    try:
        file.write_text(URDF.replace(old, new, 1))
        with pytest.raises(BadInput) as bad:
            read_bundle(folder)
    finally:
        file.write_text(URDF)
    assert str(folder) in bad.value.place
    assert place in bad.value.place
    assert re.search(r"limit|principal inertias", bad.value.reason)


@pytest.mark.parametrize(
    "empty",
    ['<mass value="0"/>' + INERTIA, '<mass value="0"/><inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/>'],
)
def test_a_placeholder_without_mass_is_read(empty: str) -> None:
    robot_from_outside(ROBOT, URDF.replace(f'<mass value="5"/>{INERTIA}', empty))


def test_rounding_of_a_maker_is_no_error() -> None:
    thin = '<inertia ixx="1" iyy="0.5" izz="0.4999" ixy="0" ixz="0" iyz="0"/>'
    robot_from_outside(ROBOT, URDF.replace(f'<mass value="5"/>{INERTIA}', f'<mass value="5"/>{thin}'))


@pytest.mark.parametrize("column", ["effort", "velocity", "position"])
def test_samples_beyond_any_machine_are_refused(folder: Path, tmp_path: Path, column: str) -> None:
    bundle = read_bundle(folder)
    (sweep,) = bundle.sweeps
    getattr(sweep.recording, column)[7] = -1e14
    with pytest.raises(BadInput, match=rf"column '{column}' is -1e\+14 in row 8; limit "):
        write_bundle(tmp_path / "again", bundle.robot, [sweep])
