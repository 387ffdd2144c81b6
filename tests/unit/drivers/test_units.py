"""Motor units <-> joint side: by hand, by round trips, by the maps of the house; of the measuring function."""

import math
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import strategies as st

from drivers.canopen import measuring
from drivers.canopen.profile import Codec, Entry, codec as codec_of, load_device_map, velocity_unit
from drivers.errors import CommunicationLost, LimitExceeded, WrongConfiguration
from drivers.ports import NoiseCommand
from tests.unit.drivers.given import axis, sweep

MILLI_RPM, INCREMENTS_PER_SECOND = 0xFDB44700, 0x00B50300


def codec(gear_ratio: float = 100.0, position_offset: float = 0.0) -> Codec:
    return Codec(gear_ratio, position_offset, rated_torque=10.0, increments=1000.0, velocity_unit=1e-3 / 60)


def test_velocity_unit_by_hand() -> None:
    assert velocity_unit(MILLI_RPM, 1000) == pytest.approx(1e-3 / 60)
    assert velocity_unit(0x00B44700, 1000) == pytest.approx(1 / 60)
    assert velocity_unit(0xFFB40300, 1000) == pytest.approx(0.1)
    assert velocity_unit(INCREMENTS_PER_SECOND, 1000) == pytest.approx(1e-3)
    assert velocity_unit(0x02B54700, 1000) == pytest.approx(100 / 1000 / 60)


@pytest.mark.parametrize("code", [0x00000000, 0xFDB44800, 0xFDB34700, 0x20B44700, 0x7FB40300])
def test_other_velocity_units_are_refused(code: int) -> None:
    with pytest.raises(WrongConfiguration, match="60A9h"):
        velocity_unit(code, 1000)


def test_reading_by_hand() -> None:
    one = codec()
    assert one.position(25_000) == pytest.approx(math.pi / 2)  # 25 motor revolutions of 100
    assert one.velocity(60_000_000) == pytest.approx(1000 * math.tau / 100)  # 60,000 rev/min = 1000 rev/s
    assert one.effort(500) == pytest.approx(500.0)  # half of 10 N m, times 100
    assert one.motor_velocity(60.0) == pytest.approx(math.tau / 100)
    assert one.motor_effort(2.0) == pytest.approx(200.0)
    assert one.motor_position(50.0) == pytest.approx(math.pi)


def test_negative_gear_turns_signs_and_keeps_power() -> None:
    forward, backward = codec(100.0), codec(-100.0)
    assert backward.velocity(1000) == -forward.velocity(1000)
    assert backward.effort(10) == -forward.effort(10)
    assert backward.position(1000) == -forward.position(1000)
    assert backward.raw_window((-1.0, 2.0)) == tuple(-limit for limit in reversed(forward.raw_window((-1.0, 2.0))))
    assert backward.raw_speed(0.5) == forward.raw_speed(0.5) > 0
    assert backward.raw_effort_limit(100.0) == forward.raw_effort_limit(100.0)


def test_writing_by_hand() -> None:
    one = codec(position_offset=math.pi / 2)
    assert one.raw_position(math.pi) == 25_000
    assert one.raw_velocity(math.tau / 100) == 60_000  # 1 motor rev/s
    assert one.raw_effort_limit(255.9) == 255  # per mille of 1000 N m, never above
    assert one.raw_window((math.pi / 2, math.pi)) == (0, 25_000)
    assert one.rev_per_min(math.tau / 100) == pytest.approx(60.0)


def test_what_does_not_fit_32_bits_is_refused() -> None:
    for value in (1e9, -1e9, math.inf, math.nan):
        with pytest.raises(LimitExceeded, match="32 bits"):
            codec().raw_velocity(value)
        with pytest.raises(LimitExceeded, match="32 bits"):
            codec().raw_position(value)


gears = st.floats(1.0, 500.0) | st.floats(-500.0, -1.0)
offsets = st.floats(-3.0, 3.0)


DEVICES = Path(__file__).parents[3] / "config" / "devices"
TURNS = 100 / math.tau  # motor revolutions in a radian behind a gear of 100


def of(device: str, told: Mapping[str, float], **changes: float) -> Codec:
    """The codec of a drive that tells these objects."""
    device_map = load_device_map(DEVICES / f"{device}.yaml")
    missing = dict.fromkeys(device_map.missing, 1.0)
    return codec_of(axis(rated_torque=2.0, **changes), device_map.units, 2.0, lambda name: {**missing, **told}[name])


FINE = {"increments": 131072, "motor_revolutions": 1, "velocity_unit": 0x00B50300}


@pytest.mark.parametrize(
    ("device", "told", "changes", "position", "velocity", "acceleration", "speed"),
    [
        ("plain-402", FINE, {}, 131072, 131072, 131072, 60),
        ("maxon-epos4", {"increments": 4096, "velocity_unit": 0xFDB44700}, {}, 4096, 60e3, 60, 60e3),  # mixes units
        *(  # the increments of the profile
            (device, {}, {"increments": 8192.0}, 8192, 8192, 8192, 60) for device in ("elmo-gold", "elmo-simpliq")
        ),
    ],
)
def test_what_a_turn_of_the_motor_is(
    device: str, told: dict[str, float], changes: dict[str, float], position: float, velocity: float,
    acceleration: float, speed: float,
) -> None:  # fmt: skip
    one = of(device, told, **changes)
    assert one.raw_position(1.0) == round(TURNS * position)
    assert one.raw_velocity(1.0) == round(TURNS * velocity)
    assert one.raw_acceleration(2.0) == round(2 * TURNS * acceleration)
    assert one.raw_max_speed(1.0) == math.ceil(TURNS * speed)


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
    one = codec_of(axis(torque_constant=0.25), device_map.units, 2.0, told.__getitem__)
    assert one.effort(1000) == pytest.approx(4.0 * 0.25 * 100)  # 4 A, 0.25 N m/A


CODEC = Codec(gear_ratio=-100.0, position_offset=0.0, rated_torque=20.0, increments=2.0**20, velocity_unit=1e-3 / 60)
AXIS = axis(joint="q", gear_ratio=-100.0, rated_torque=20.0)
NOISE = NoiseCommand(
    joint="q",
    offset_velocity=math.tau / 6000,  # 1 rev/min of the motor
    effort=30.0,
    lowest=1.0,
    highest=40.0,
    period=2.0,
    periods=5,
    seed=123,
    softening=0.5,
    ramp=0.5,
    settle=1.0,
    sample_rate=250.0,
    velocity_limit=0.1,
    effort_limit=1000.0,
    position_window=(-0.5, 0.5),
)
SWEEP = sweep(joint="q")


def settings(pairs: list[tuple[Entry, float]]) -> dict[tuple[int, int], float]:
    return {(entry.index, entry.sub): value for entry, value in pairs}


def test_noise_in_drive_units_behind_a_gear_that_turns_round() -> None:
    assert settings(measuring.noise_parameters(NOISE, CODEC)) == {
        (0x2100, 4): pytest.approx(-1.0),  # rev/min
        (0x2100, 5): 0.5,
        (0x2100, 6): 1.0,
        (0x2100, 7): 2.0,
        (0x2100, 8): 5,
        (0x2100, 10): 4,  # ms
        (0x2100, 12): 1,
        (0x2104, 1): pytest.approx(0.3),  # N m of the motor; an RMS has no sign
        (0x2104, 2): 1.0,
        (0x2104, 3): 40.0,
        (0x2104, 4): 123,
    }


def test_a_page_of_a_noise_run_holds_the_injected_torque() -> None:
    page = np.zeros(3, measuring.NOISE_SAMPLE)
    page["cycle"], page["torque"], page["injected"] = [4, 5, 6], [1.0, 2.0, 3.0], [0.1, -0.2, 0.3]
    block = measuring.samples(page.tobytes(), 4, 3, AXIS, CODEC, 4, "q (node 1)", noise=True)
    assert block.excitation_effort == pytest.approx(np.array([-10.0, 20.0, -30.0]))
    assert block.effort == pytest.approx(np.array([-100.0, -200.0, -300.0]))
    assert block.time == pytest.approx(np.array([0.016, 0.020, 0.024]))
    with pytest.raises(CommunicationLost, match="page of 108 bytes instead of 3 samples"):
        measuring.samples(page.tobytes(), 4, 3, AXIS, CODEC, 4, "q (node 1)", noise=False)
    of_a_sweep = np.zeros(3, measuring.SAMPLE)
    of_a_sweep["cycle"] = [4, 5, 6]
    assert (
        measuring.samples(of_a_sweep.tobytes(), 4, 3, AXIS, CODEC, 4, "q (node 1)", noise=False).excitation_effort
        is None
    )


def test_softening_lowers_the_gain_and_lengthens_the_reset_time() -> None:
    of, settled = measuring.MeasuringObject, dict[Entry, float]()
    commissioned = {of.COMMISSIONED_GAIN: 8.0, of.COMMISSIONED_RESET_TIME: 0.02}
    sdo: Any = SimpleNamespace(read=commissioned.__getitem__, settle=settled.__setitem__)
    measuring.soften(sdo, 0.25)
    assert settled == {of.GAIN: 2.0, of.RESET_TIME: 0.08}
