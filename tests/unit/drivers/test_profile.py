"""Drive profiles, the registry and device maps: those of the house are read, wrong ones refused with the place."""

import copy
import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from drivers.canopen.frames import MotionPdo, PositionPdo, SetPoint, Wires, decode, stop
from drivers.canopen.profile import (
    STANDARD,
    TYPES,
    DeviceMap,
    DeviceUnits,
    Pdos,
    SetPointWay,
    bits,
    load_device_map,
    parse_profile,
)
from drivers.canopen.sdo import streaming_pdos
from drivers.cia402.profile import parse
from drivers.errors import BadProfile
from drivers.modbus.registers import load_registers
from drivers.registry import load_profile, open_drive, open_profile
from simulator.modbus.registers import RegisterMapError, load_register_map
from simulator.scenario import ScenarioError, load_scenario

DRIVES = Path(__file__).parents[3] / "config" / "drives"


@pytest.fixture
def profile() -> dict[str, Any]:
    return load_profile(DRIVES / "virtual-max100.yaml")


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("adapter", "telepathy", "adapter: 'telepathy' is unknown; installed: .*canopen"),
        ("axes.0.velocity_limt", 1.0, "axes.0.velocity_limt: Extra inputs are not permitted"),
        ("axes.0.rated_torque", None, "axes.0.rated_torque: .*valid number"),
        ("axes.0.velocity_limit", -1.0, "axes.0.velocity_limit: .*greater than 0.*given: -1.0"),
        ("axes.0.gear_ratio", 0.0, "axes.0: gear_ratio must not be 0"),
        ("axes.0.gear_ratio", float("nan"), "axes.0.gear_ratio: .*finite"),
        ("axes.0.position_limits", [1.0, -1.0], "axes.0: .*1.0 is not below -1.0"),
        ("axes.1.node", 1, "joints .* and nodes .* must each be different"),
        ("axes.1.joint", "joint_1", "joints .* must each be different"),
        ("bus.port", 70000, "bus.port: .*65535.*given: 70000"),
        ("bus.sync_period", 0.0015, "bus: .*whole milliseconds"),
        (
            "bus.host_timeout",
            3.2,
            r"axes.0: joint_1 would travel 3.325 rad after the loss of its host \(velocity_limit 1 rad/s "
            r"for bus.host_timeout 3.2 s, then quick_stop.* 4 rad/s\^2\), limit 3.2 rad: .*travel_limits.rad",
        ),
        ("travel_limits", {}, "axes.0: joint_1 would travel 3.125 rad .*limit 1.6 rad"),
        ("axes.1.velocity_limit", 1.2, "axes.1: joint_2 would travel 3.78 rad"),
        ("travel_limits.rad", 0.0, "travel_limits.rad: .*greater than 0"),
        ("bus.host_node", 3, "host_node 3"),
        ("eds", "nowhere.eds", "eds: no file .*nowhere.eds"),
        ("device", "nowhere.yaml", r"device: no file .*nowhere\.yaml"),
        ("axes.0.unit", "m", r"^axes\.0: load_encoder: not supported .* set it to false"),
        ("axes.0.identity.product", 0x999, "eds: .*is for vendor 00005357h, product 00000402h; joint_1 is .*00000999h"),
    ],
)
def test_a_bad_profile_is_refused_with_place_and_value(
    profile: dict[str, Any], path: str, value: object, message: str
) -> None:
    bad: Any = copy.deepcopy(profile)
    *way, last = path.split(".")
    place = bad
    for part in way:
        place = place[int(part)] if part.isdigit() else place[part]
    place[last] = value
    with pytest.raises(BadProfile, match=message):
        open_drive(bad, DRIVES)


def test_an_error_in_a_file_names_the_file(profile: dict[str, Any], tmp_path: Path) -> None:
    bad = tmp_path / "machine.yaml"
    eds = str(DRIVES / profile["eds"])
    for change, message in (
        ({"adapter": "telepathy"}, "adapter: 'telepathy' is unknown"),
        ({"axes": None}, "axes: Input should be"),
    ):
        bad.write_text(yaml.safe_dump(profile | {"eds": eds} | change))
        with pytest.raises(BadProfile, match=f"^{re.escape(str(bad))}: {message}"):
            open_profile(bad)


def test_a_long_value_is_shown_by_its_beginning(profile: dict[str, Any]) -> None:
    profile["adapter"] = ["x"] * 100_000
    with pytest.raises(BadProfile) as refusal:
        parse_profile(profile, DRIVES)
    assert str(refusal.value).startswith("adapter: Input should be 'canopen' (given: ['x', 'x'")
    assert len(str(refusal.value)) < 300


def test_an_eds_may_tell_its_vendor_and_no_product(profile: dict[str, Any], tmp_path: Path) -> None:
    """As some stacks write it."""
    profile["eds"] = "other.eds"
    (tmp_path / "other.eds").write_text("[DeviceInfo]\nVendorNumber=0x5357\n[1000]\nDataType=7\n")
    parse_profile(profile, tmp_path)
    (tmp_path / "other.eds").write_text("[DeviceInfo]\nVendorNumber=0x5358\n[1000]\nDataType=7\n")
    with pytest.raises(BadProfile, match=r"is for vendor 00005358h; joint_1 is 00005357h, 00000402h"):
        parse_profile(profile, tmp_path)


def test_an_eds_that_is_none_is_refused(profile: dict[str, Any], tmp_path: Path) -> None:
    profile["eds"] = "other.eds"
    for content in ("", "no section", "[DeviceInfo]\nVendorNumber=x\nProductNumber=1\n", ";" * (2**22 + 1)):
        (tmp_path / "other.eds").write_text(content)
        with pytest.raises(BadProfile, match=r"other\.eds: (not an EDS or DCF|is larger than)"):
            parse_profile(profile, tmp_path)


def test_a_linear_axis_has_its_own_limit_of_travel(profile: dict[str, Any]) -> None:
    linear = profile["axes"][2] | {"unit": "m", "load_encoder": False}
    with pytest.raises(
        BadProfile, match=r"axes.0: joint_3 would travel 3.125 m after the loss of its host .* limit 0.5 m"
    ):
        parse_profile(profile | {"axes": [linear]}, DRIVES)
    near = linear | {"velocity_limit": 0.16}  # 0.4832 m
    assert parse_profile(profile | {"axes": [near]}, DRIVES).axes[0].travel_without_host(3.0) == pytest.approx(0.4832)


CONFIG = DRIVES.parent
DEVICES = sorted((CONFIG / "devices").glob("*.yaml"))
PAGE = (CONFIG.parent / "docs/reference/device-map.md").read_text(encoding="utf-8")


def table(after: str) -> list[str]:
    """The names in the first column of the first table behind a heading."""
    rows = PAGE.partition(f"{after}\n")[2].partition("\n#")[0].splitlines()
    cells = [row.split("|")[1] for row in rows if row.startswith("| `")]
    return [name for cell in cells for name in re.findall(r"`(\w+)`", cell)]


def test_the_page_has_every_field_and_no_other() -> None:
    for heading, model in (("## The file", DeviceMap), ("### `units`", DeviceUnits), ("### `pdos`", Pdos)):
        assert table(heading) == list(model.model_fields), heading
    assert table("### Modes of excitation") == [way.value for way in SetPointWay]
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
        for pdo in streaming_pdos(device_map, way, 5):
            assert sum(bits(entry) for entry in pdo.mapped) <= 64
            assert pdo.identifier & 0x7F == 5


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
    for identifier, data, event in (
        (0x182, "2700 0a000000 0500", MotionPdo(2, 0x27, 10, 5)),
        (0x382, "01000000 0a000000", PositionPdo(2, 1, 0, 10)),
        (0x282, "01000000 0a000000", None),
        (0x402, "0200", SetPoint(2, b"\2\0")),
        (0x202, "000000000000", SetPoint(2, bytes(6))),
    ):
        assert decode(identifier, bytes.fromhex(data), wires=wires) == event


def test_a_stop_never_tells_a_position() -> None:
    wires = Wires(set_point=1, stop=2)
    assert stop([1, 2], [2], wires=wires) == [(0x301, b"\2\0"), (0x302, b"\2\0"), (0x80, b""), (0x000, b"\2\2")]
    for path in DEVICES:
        device_map = load_device_map(path)
        assert device_map.pdos.stop is not None or set(device_map.excitation) == {SetPointWay.CYCLIC_VELOCITY}


def test_a_way_takes_the_best_mode_that_the_drive_has() -> None:
    cyclic, offset = SetPointWay.CYCLIC_VELOCITY, SetPointWay.VELOCITY_OFFSET
    assert [cyclic.mode(supported) for supported in (0x100, 0x005)] == [9, None]
    assert [offset.mode(supported) for supported in (0x105, 0x005, 0x041, None)] == [9, 3, None, 9]


READERS: dict[str, Any] = {
    **{"profile": load_profile, "device map": load_device_map, "registers": load_registers},
    **{"virtual registers": load_register_map, "scenario": load_scenario},
}
ERRORS = (BadProfile, RegisterMapError, ScenarioError)
REFUSED = {
    b"\xff\xfe": "not YAML|cannot be read: .*utf-8",
    b"a: [": "not YAML",
    b"a: 2001-13-45": "not YAML",
    b"a: !!int ''": "not YAML",
    b"a: !!timestamp x": "not YAML",
    b"a: " + b"[" * 3000: "not YAML: nested too deeply, limit 32 levels",
    b"axes: " + b"[" * 33 + b"]" * 33: "not YAML: nested too deeply, limit 32 levels",
    b"&a {axes: *a}": r"not YAML: alias \*a is inside of its own anchor",
    b"axes: &a [{identity: *a}]": r"not YAML: alias \*a is inside of its own anchor",
    b"a: &a %s\nb: [%s]" % (b"n" * 100_000, b", ".join([b"*a"] * 100)): "aliases stand for more than 4194304 ",
    b" " * 2**20 + b"a": "is larger than|YAML of 1048577 characters, limit 1048576",
    b"": "No such file",
    b"- 1": "must be a mapping|map: Input|not a mapping",
}


@pytest.mark.parametrize("read", READERS.values(), ids=READERS)
@pytest.mark.parametrize(("content", "message"), REFUSED.items(), ids=[repr(each[:12]) for each in REFUSED])
def test_what_is_no_description_is_refused_by_name(read: Any, content: bytes, message: str, tmp_path: Path) -> None:
    """A profile that holds itself took all of Python's stack when its open values were looked for."""
    path = tmp_path / "it.yaml"
    if content:
        path.write_bytes(content)
    with pytest.raises(ERRORS, match=rf"it\.yaml: .*({message})"):
        read(path)
