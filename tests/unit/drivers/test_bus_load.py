"""The load of the bus by numbers computed by hand."""

from contextlib import nullcontext
from pathlib import Path

import pytest

from drivers.canopen.bus_load import bus_load, check_bus_load
from drivers.canopen.configuration import Pdo, pdos
from drivers.canopen.device_map import Way, load_device_map
from drivers.canopen.profile import BusProfile
from drivers.errors import LimitExceeded

DEVICES = Path(__file__).parents[3] / "config" / "devices"


def bus(**changes: object) -> BusProfile:
    return BusProfile.model_validate({"interface": "virtual", "channel": "can0", **changes})


def of(axes: int) -> list[tuple[Pdo, ...]]:
    plain = load_device_map(DEVICES / "plain-402.yaml")
    cyclic = tuple(p for p in pdos(plain, Way.CYCLIC_VELOCITY, 1) if len(p.mapped) > 1)
    assert len(cyclic) == 3
    return [cyclic] * axes


# a cycle of three axes: 55 + 3 (115 + 135 + 135) bits = 1210; heartbeats: 65 bits 40 times a second
@pytest.mark.parametrize(
    ("settings", "axes", "told"),
    [
        ({"bitrate": 250_000}, 3, r"bus can0: .*takes 122% of 250000 bit/s, 70% are allowed; sync_period 0\.008 s"),
        ({"bitrate": 250_000, "sync_period": 0.008}, 3, ""),
        ({"bitrate": 250_000, "sync_period": 0.007}, 3, "70% are allowed"),
        ({"bitrate": 1_000_000}, 3, ""),
        ({"sync_period": 0.001}, 20, ""),  # an unknown bit rate is not judged
        ({"bitrate": 10_000, "drive_heartbeat": 0.001}, 10, "no sync_period fits"),
    ],
)
def test_what_does_not_fit_is_refused_with_the_figure_and_the_cycle_that_fits(
    settings: dict[str, float], axes: int, told: str
) -> None:
    with pytest.raises(LimitExceeded, match=told) if told else nullcontext():
        check_bus_load(bus(**settings), of(axes), axes)


def test_the_load_by_hand() -> None:
    # 1210 bits a cycle of 4 ms, and 65 bits 40 times a second (see above)
    settings = bus(bitrate=1_000_000, sync_period=0.004)
    beats = 65 * (1 / settings.host_heartbeat + 3 / settings.drive_heartbeat)
    found = bus_load(settings, of(3), 3)
    assert found == pytest.approx((1210 / 0.004 + beats) / 1e6)
    assert bus_load(bus(), of(3), 3) == 0.0
