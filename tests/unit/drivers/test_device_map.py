"""Device maps: those of the house are read, wrong ones are refused with the place."""

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from drivers.canopen.configuration import pdos
from drivers.canopen.device_map import (
    STANDARD,
    TYPES,
    VIRTUAL_AXIS,
    DeviceMap,
    Pdos,
    Units,
    Way,
    bits,
    load_device_map,
)
from drivers.canopen.frames import MotionPdo, PositionPdo, SetPoint, Wires, decode, stop
from drivers.canopen.profile import parse_profile
from drivers.cia402.profile import parse
from drivers.errors import BadProfile
from drivers.registry import load_profile

CONFIG = Path(__file__).parents[3] / "config"
DEVICES = sorted((CONFIG / "devices").glob("*.yaml"))


PAGE = (CONFIG.parent / "docs/reference/device-map.md").read_text(encoding="utf-8")


def table(after: str) -> list[str]:
    """The names in the first column of the first table behind a heading."""
    rows = PAGE.partition(f"{after}\n")[2].partition("\n#")[0].splitlines()
    cells = [row.split("|")[1] for row in rows if row.startswith("| `")]
    return [name for cell in cells for name in re.findall(r"`(\w+)`", cell)]


def test_the_page_has_every_field_and_no_other() -> None:
    for heading, model in (("## The file", DeviceMap), ("### `units`", Units), ("### `pdos`", Pdos)):
        assert table(heading) == list(model.model_fields), heading
    assert table("### Modes of excitation") == [way.value for way in Way]
    assert table("### Names of objects") == list(STANDARD)
    types = {code: name for name, code in TYPES.items()}
    for name, entry in STANDARD.items():
        assert f"| `{name}` | {entry.index:04X}h:{entry.sub:02X} | {types[entry.type]} |" in PAGE
    assert {path.stem for path in DEVICES} == set(re.findall(r"`([a-z]+-[a-z0-9]+)`", PAGE.partition("## The file")[0]))


def a_map(**changes: object) -> DeviceMap:
    return parse(DeviceMap, {"pdos": {"stop": 2}, **changes})


@pytest.mark.parametrize("path", DEVICES, ids=lambda path: path.stem)
def test_every_map_of_the_house_is_one_and_its_pdos_fit(path: Path) -> None:
    device_map = load_device_map(path)
    assert device_map.description
    for way in device_map.excitation:
        for pdo in pdos(device_map, way, 5):
            assert sum(bits(entry) for entry in pdo.mapped) <= 64
            assert pdo.identifier & 0x7F == 5


def test_a_profile_without_a_map_means_the_virtual_drive() -> None:
    assert load_device_map(CONFIG / "devices/virtual-axis.yaml") == VIRTUAL_AXIS
    profile = load_profile(CONFIG / "drives/virtual-max100.yaml")
    assert "device" not in profile
    assert parse_profile(profile, CONFIG / "drives").device_map == VIRTUAL_AXIS


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"objects": {"speed": {"index": 0x606C, "type": "i32"}}}, r"objects: \['speed'\] are unknown"),
        ({"objects": {"velocity": {"index": 0x606C, "type": "i16"}}}, "objects.velocity: type must be i32"),
        ({"objects": {"velocity": {"index": 0x606C, "type": "f32"}}}, "objects.velocity.type: .*given: 'f32'"),
        ({"missing": {"velocity": "host"}}, r"missing: \['velocity'\] are needed to move and measure an axis"),
        ({"missing": {"torque": "host"}}, r"missing: \['torque'\] are used by this map"),
        ({"missing": {"target_velocity": "host"}}, r"\['target_velocity'\] are used by this map"),
        ({"samples": "counter", "missing": {"sample_counter": "host"}}, r"\['sample_counter'\] are used by this map"),
        (
            {"units": {"effort": "current"}, "missing": {"rated_current": "host"}},
            r"\['rated_current'\] are used by this map",
        ),
        ({"missing": {"increments": "profile"}}, r"\['increments'\] are used by this map"),
        ({"missing": {"velocity_unit": "host"}}, r"\['velocity_unit'\] are used by this map"),
        ({"excitation": []}, "excitation: .*at least 1 item"),
        ({"pdos": {"state": 2}}, r"TPDO \[2, 2\] must each be different"),
        ({"pdos": {"stop": 2, "unused_rpdos": [2]}}, r"RPDO \[1, 2, 2\] must each be different"),
        ({"pdos": {"stop": 5}}, "pdos.stop: .*less than or equal to 4.*given: 5"),
        (
            {"pdos": {}, "excitation": ["cyclic_position"]},
            "pdos.stop is missing: .*needs an RPDO with the controlword and no target",
        ),
        ({"excitation": ["torque_offset"]}, "excitation.0: .*given: 'torque_offset'"),
        ({"units": {"velocity": "mph"}}, "units.velocity: .*given: 'mph'"),
        ({"colour": "red"}, "colour: Extra inputs"),
    ],
)
def test_a_wrong_map_is_refused_with_its_place(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(BadProfile, match=message):
        a_map(**changes)


@pytest.mark.parametrize(
    ("content", "axis", "message"),
    [
        ({"vendor": 0x9A}, {}, "is for vendor 0000009Ah; joint_1 is 00005357h"),
        (
            {"units": {"increments": "profile"}},
            {},
            "axes: joint_1: increments is missing: the device map says `increments: profile`",
        ),
        (
            {"units": {"effort": "current"}},
            {},
            "axes: joint_1: torque_constant is missing: .* the profile must give N m/A",
        ),
        ({"units": {"side": "joint"}}, {"gear_ratio": -100.0}, "axes: joint_1: gear_ratio must be above 0"),
    ],
)
def test_a_profile_that_does_not_fit_its_map(
    tmp_path: Path, content: dict[str, Any], axis: dict[str, Any], message: str
) -> None:
    path = tmp_path / "map.yaml"
    path.write_text(yaml.safe_dump(content))
    profile: Any = load_profile(CONFIG / "drives/virtual-max100.yaml") | {"device": str(path)}
    profile["axes"][0] |= axis
    with pytest.raises(BadProfile, match=message):
        parse_profile(profile, CONFIG / "drives")


def test_frames_are_read_where_the_map_has_them() -> None:
    wires = Wires(set_point=1, stop=3, state=1, place=3, counted=False)
    told = bytes.fromhex("2700 0a000000 0500")
    assert decode(0x182, told, wires=wires) == MotionPdo(2, 0x27, 10, 5)
    assert decode(0x382, bytes.fromhex("01000000 0a000000"), wires=wires) == PositionPdo(2, 1, 0, 10)
    assert decode(0x282, bytes.fromhex("01000000 0a000000"), wires=wires) is None
    assert decode(0x402, b"\2\0", wires=wires) == SetPoint(2, b"\2\0")
    assert decode(0x202, bytes(6), wires=wires) == SetPoint(2, bytes(6))


def test_a_stop_never_tells_a_position() -> None:
    wires = Wires(set_point=1, stop=2)
    assert stop([1, 2], [2], wires=wires) == [(0x301, b"\2\0"), (0x302, b"\2\0"), (0x80, b""), (0x000, b"\2\2")]
    for path in DEVICES:
        device_map = load_device_map(path)
        assert device_map.pdos.stop is not None or set(device_map.excitation) == {Way.CYCLIC_VELOCITY}


@pytest.mark.parametrize(
    ("way", "supported", "mode"),
    [
        (Way.CYCLIC_VELOCITY, 0x100, 9),
        (Way.CYCLIC_VELOCITY, 0x005, None),
        (Way.VELOCITY_OFFSET, 0x105, 9),
        (Way.VELOCITY_OFFSET, 0x005, 3),
        (Way.VELOCITY_OFFSET, 0x041, None),
        (Way.VELOCITY_OFFSET, None, 9),
    ],
)
def test_a_way_takes_the_best_mode_that_the_drive_has(way: Way, supported: int | None, mode: int | None) -> None:
    assert way.mode(supported) == mode


def test_the_velocity_offset_is_the_last_choice_of_a_plain_drive() -> None:
    assert load_device_map(CONFIG / "devices" / "plain-402.yaml").excitation[-1] is Way.VELOCITY_OFFSET
