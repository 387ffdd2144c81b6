"""Parameters of the measuring function in drive units, and the bytes of its trace pages."""

import math

import numpy as np
import pytest

from drivers.canopen import measuring
from drivers.canopen.objects import Entry
from drivers.canopen.units import Codec
from drivers.errors import CommunicationLost
from drivers.ports import NoiseCommand
from tests.unit.drivers.given import axis, sweep

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


def test_a_sweep_says_nothing_of_noise() -> None:
    assert {index for index, _ in settings(measuring.parameters(SWEEP, CODEC))} == {0x2100, 0x2101, 0x2102, 0x2103}
    assert (0x2100, 12) not in settings(measuring.parameters(SWEEP, CODEC))


def test_a_page_of_a_noise_run_holds_the_injected_torque() -> None:
    page = np.zeros(3, measuring.NOISE_SAMPLE)
    page["cycle"], page["torque"], page["injected"] = [4, 5, 6], [1.0, 2.0, 3.0], [0.1, -0.2, 0.3]
    block = measuring.samples(page.tobytes(), 4, 3, AXIS, CODEC, 4, "q (node 1)", noise=True)
    assert block.excitation_effort == pytest.approx(np.array([-10.0, 20.0, -30.0]))
    assert block.effort == pytest.approx(np.array([-100.0, -200.0, -300.0]))
    assert block.time == pytest.approx(np.array([0.016, 0.020, 0.024]))
    with pytest.raises(CommunicationLost, match="page of 108 bytes instead of 3 samples"):
        measuring.samples(page.tobytes(), 4, 3, AXIS, CODEC, 4, "q (node 1)")
    of_a_sweep = np.zeros(3, measuring.SAMPLE)
    of_a_sweep["cycle"] = [4, 5, 6]
    assert measuring.samples(of_a_sweep.tobytes(), 4, 3, AXIS, CODEC, 4, "q (node 1)").excitation_effort is None
