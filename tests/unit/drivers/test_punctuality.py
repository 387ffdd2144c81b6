"""Deadlines kept and missed, and what of the kernel's timing needs no kernel; tests/vcan does the rest."""

import random

import pytest

from drivers.canopen.bus import Steering, set_point_source
from drivers.canopen.frames import Wires
from drivers.canopen.host_sweep import Punctuality
from drivers.canopen.profile import BusProfile
from tests.unit.drivers.streaming_bench import Drive, bench


def sent(clock: Punctuality, *times: float) -> list[float]:
    return [clock.sent(time) for time in times]


def test_lateness_by_hand() -> None:
    clock = Punctuality(0.01, allowed=3, limit=1.0)
    clock.begin(5.0)
    assert [clock.sent(at) for at in (5.0, 5.012, 5.019)] == pytest.approx([0.0, 0.002, -0.001])
    assert clock.due == pytest.approx(5.03)
    timing = clock.timing("thread")
    assert (timing.source, timing.cycles, timing.missed) == ("thread", 3, 0)
    assert (timing.median_lateness, timing.worst_lateness) == pytest.approx((0.0, 0.002))
    assert clock.sent(5.0655) == pytest.approx(0.0055)  # deadlines that passed are left out
    assert clock.due == pytest.approx(5.07)
    assert clock.timing("bcm").missed == 3
    assert clock.verdict is None
    clock.sent(5.0801)
    assert clock.verdict == "4 deadlines of 10 ms were missed, 3 are allowed; the worst set-point was 35.5 ms late"


@pytest.mark.parametrize(
    ("nominal", "delay"), [(1e-3, 5e-6), (1e-3, 60e-6), (2e-3, 5e-6), (2e-3, 90e-6), (5e-3, 250e-6)]
)
def test_a_kernel_that_is_late_in_each_interval_keeps_the_mean_all_the_same(delay: float, nominal: float) -> None:
    """As net/can/bcm.c: an interval counts from the moment of waking up, which jitters about a constant delay."""
    chance, per_cycle, per_step = random.Random(1), 2, 16
    steering = Steering(nominal, per_cycle * per_step)
    now, lateness = 0.0, list[float]()
    for cycle in range(1, 20_001):
        for _ in range(per_cycle):
            now += round(steering.interval, 6) + chance.uniform(0.0, 2 * delay)
        lateness.append(now - cycle * per_cycle * nominal)
        steering.note(lateness[-1])
        if cycle % per_step == 0:
            steering.adjust()
    settled = lateness[2000:]
    assert abs(sum(settled) / len(settled)) < 20e-6 + 0.1 * delay
    assert max(map(abs, settled)) < 50 * delay
    assert now == pytest.approx(20_000 * per_cycle * nominal, rel=1e-4)


@pytest.mark.parametrize("stall", [0.0035, 0.005, 0.021, 0.1])
def test_a_kernel_that_stalled_comes_back_to_the_grid(stall: float) -> None:
    """A stall costs cycles (a virtual machine's lost time): they are left out, the rest of a period is made up for."""
    period, per_cycle, per_step = 0.004, 4, 8
    steering, clock = Steering(period / per_cycle, per_cycle * per_step), Punctuality(period, 100, 1.0)
    clock.begin(0.0)
    now, late = 0.0, list[float]()
    for cycle in range(1000):
        late.append(clock.sent(now))
        steering.note(late[-1])
        if cycle % per_step == 0:
            steering.adjust()
        now += per_cycle * round(steering.interval, 6) + (stall if cycle == 300 else 0.0)
    assert clock.timing("bcm").missed == int(stall / period)
    assert max(map(abs, late)) < period  # each cycle still belongs to its deadline
    assert max(map(abs, late[500:])) < 0.02 * period
    assert abs(clock.timing("bcm").median_lateness) < 0.05 * period


def test_the_steering_stays_within_reason() -> None:
    steering = Steering(1e-3, 32)
    for late in (10.0, -10.0, 1e6, -1e6):
        for _ in range(50):
            steering.note(late)
            steering.adjust()
            assert 0.899e-3 <= steering.interval <= 1.101e-3


@pytest.mark.parametrize(("missed_cycles", "counted", "waits"), [(0, False, False), (1, False, True), (1, True, False)])
def test_the_host_waits_for_drives_that_count_no_samples_where_cycles_may_be_late(
    missed_cycles: int, counted: bool, waits: bool
) -> None:
    profile = BusProfile(interface="virtual", channel="x", missed_cycles=missed_cycles)
    assert profile.waits(Wires(counted=counted)) is waits


async def test_only_socketcan_has_a_kernel_that_times() -> None:
    async with bench(Drive(1)) as on:
        assert set_point_source(on.bus) == "thread"
