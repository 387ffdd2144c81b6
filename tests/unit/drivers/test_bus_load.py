"""The load of the bus by numbers computed by hand."""

from pathlib import Path

import pytest

from drivers.canopen.bus_load import bus_load, check_bus_load, frame_bits
from drivers.canopen.configuration import Pdo, pdos
from drivers.canopen.device_map import Way, load_device_map
from drivers.canopen.profile import BusProfile
from drivers.errors import LimitExceeded

DEVICES = Path(__file__).parents[3] / "config" / "devices"


def test_the_longest_frames() -> None:
    assert frame_bits(0) == 55  # 47 bits and 8 stuff bits
    assert frame_bits(8) == 135  # 111 bits and 24 stuff bits


def bus(**changes: object) -> BusProfile:
    return BusProfile.model_validate({"interface": "virtual", "channel": "can0", **changes})


def of(axes: int) -> list[tuple[Pdo, ...]]:
    plain = load_device_map(DEVICES / "plain-402.yaml")
    cyclic = tuple(p for p in pdos(plain, Way.CYCLIC_VELOCITY, 1) if len(p.mapped) > 1)
    assert len(cyclic) == 3
    return [cyclic] * axes


def test_what_does_not_fit_is_refused_with_the_figure_and_the_cycle_that_fits() -> None:
    # a cycle of three axes: 55 + 3 (115 + 135 + 135) bits = 1210; heartbeats: 65 bits 40 times a second
    with pytest.raises(
        LimitExceeded, match=r"bus can0: .*takes 122% of 250000 bit/s, 70% are allowed; sync_period 0\.008 s"
    ):
        check_bus_load(bus(bitrate=250_000), of(3), 3)
    check_bus_load(bus(bitrate=250_000, sync_period=0.008), of(3), 3)
    with pytest.raises(LimitExceeded):
        check_bus_load(bus(bitrate=250_000, sync_period=0.007), of(3), 3)


def test_three_axes_at_a_megabit_fit_and_an_unknown_bit_rate_is_not_judged() -> None:
    check_bus_load(bus(bitrate=1_000_000), of(3), 3)
    check_bus_load(bus(sync_period=0.001), of(20), 20)


def test_a_bus_that_heartbeats_fill_fits_nothing() -> None:
    with pytest.raises(LimitExceeded, match="no sync_period fits"):
        check_bus_load(bus(bitrate=10_000, drive_heartbeat=0.001), of(1), 10)


def test_the_load_by_hand() -> None:
    # 1210 bits a cycle of 4 ms, and 65 bits 40 times a second (see above)
    settings = bus(bitrate=1_000_000, sync_period=0.004)
    beats = 65 * (1 / settings.host_heartbeat + 3 / settings.drive_heartbeat)
    found = bus_load(settings, of(3), 3)
    assert found == pytest.approx((1210 / 0.004 + beats) / 1e6)
    assert bus_load(bus(), of(3), 3) == 0.0
