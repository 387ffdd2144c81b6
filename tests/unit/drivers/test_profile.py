"""Drive profiles and the registry."""

import copy
import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from drivers.canopen.profile import parse_profile
from drivers.errors import BadProfile
from drivers.registry import load_profile, open_drive, open_profile

DRIVES = Path(__file__).parents[3] / "config" / "drives"


@pytest.fixture
def profile() -> dict[str, Any]:
    return load_profile(DRIVES / "virtual-max100.yaml")


def test_every_profile_of_the_house_opens() -> None:
    for path in DRIVES.glob("*.yaml"):
        port = open_drive(load_profile(path), path.parent)
        assert port.joints


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


def test_a_linear_axis_has_no_load_encoder(profile: dict[str, Any]) -> None:
    profile["axes"][0]["unit"] = "m"
    with pytest.raises(BadProfile, match=r"^axes\.0: load_encoder: not supported .* set it to false"):
        open_drive(profile, DRIVES)


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
