"""What a raw value means by the maps of the house, by hand."""

import math
from collections.abc import Mapping
from pathlib import Path

import pytest

from drivers.canopen.device_map import load_device_map
from drivers.canopen.units import Codec, codec
from tests.unit.drivers.given import axis

DEVICES = Path(__file__).parents[3] / "config" / "devices"
TURNS = 100 / math.tau  # motor revolutions in a radian behind a gear of 100


def of(device: str, told: Mapping[str, float], **changes: float) -> Codec:
    """The codec of a drive that tells these objects."""
    device_map = load_device_map(DEVICES / f"{device}.yaml")
    missing = dict.fromkeys(device_map.missing, 1.0)
    return codec(axis(rated_torque=2.0, **changes), device_map.units, 2.0, lambda name: {**missing, **told}[name])


def test_plain_402() -> None:
    one = of("plain-402", {"increments": 131072, "motor_revolutions": 1, "velocity_unit": 0x00B50300})
    assert one.raw_position(1.0) == round(TURNS * 131072)
    assert one.raw_velocity(1.0) == round(TURNS * 131072)
    assert one.raw_acceleration(2.0) == round(2 * TURNS * 131072)
    assert one.raw_max_speed(1.0) == math.ceil(TURNS * 60)  # rev/min


def test_epos4_mixes_units() -> None:
    one = of("maxon-epos4", {"increments": 4096, "velocity_unit": 0xFDB44700})
    assert one.raw_position(1.0) == round(TURNS * 4096)
    assert one.raw_velocity(1.0) == round(TURNS * 60e3)  # 10^-3 rev/min
    assert one.raw_acceleration(1.0) == round(TURNS * 60)  # rev/min/s
    assert one.raw_max_speed(1.0) == round(TURNS * 60e3)


@pytest.mark.parametrize("device", ["elmo-gold", "elmo-simpliq"])
def test_elmo_counts_the_increments_of_the_profile(device: str) -> None:
    one = of(device, {}, increments=8192.0)
    assert one.raw_position(1.0) == one.raw_velocity(1.0) == one.raw_acceleration(1.0) == round(TURNS * 8192)
    assert one.raw_max_speed(1.0) == math.ceil(TURNS * 60)


def test_powerball_counts_behind_the_gear_whatever_the_gear() -> None:
    for gear_ratio in (100.0, 161.0):
        one = of("schunk-powerball", {}, gear_ratio=gear_ratio)
        assert one.raw_position(math.pi / 2) == 90_000
        assert one.raw_velocity(math.radians(10)) == 10_000
        assert one.raw_acceleration(math.radians(10)) == 10_000
        assert one.position(90_000) == pytest.approx(math.pi / 2)
        assert one.effort(500) == pytest.approx(0.5 * 2.0 * gear_ratio)
        assert one.raw_window((-1.0, 1.0)) == (-57296, 57296)


def test_a_current_becomes_a_torque_by_the_constant_of_the_profile(tmp_path: Path) -> None:
    path = tmp_path / "map.yaml"
    path.write_text("units: {effort: current}\n")
    told = {"increments": 1000, "motor_revolutions": 1, "velocity_unit": 0x00B44700, "rated_current": 4000}
    device_map = load_device_map(path)
    plain = of("plain-402", told)
    assert plain.effort(1000) == pytest.approx(2.0 * 100)
    one = codec(axis(torque_constant=0.25), device_map.units, 2.0, told.__getitem__)
    assert one.effort(1000) == pytest.approx(4.0 * 0.25 * 100)  # 4 A, 0.25 N m/A
