"""Where a sweep starts in a CNC's trace, and what a trace that is not the sweep's is refused for."""

import tracemalloc
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from service import BadInput
from service.formats.traces.alignment import check_follows, motion_start
from service.identification.design.excitation import Excitation, way
from service.model import Sine

SINES = tuple(Sine(frequency=f, amplitude=0.003, phase=p) for f, p in ((2.0, 0.0), (3.0, 4.7), (4.0, 1.6), (5.0, 3.1)))
SWEEP = Excitation(0.0162, SINES, 1.0, 3, 0.5, 0.5)
POSITION = -0.52
RATE = 250.0
# another sweep of the same axis: slower, with other phases
SLOWER = tuple(Sine(frequency=sine.frequency, amplitude=0.0028, phase=0.0) for sine in SINES)
OTHER = replace(SWEEP, offset_velocity=0.0148, sines=SLOWER)


def clock(length: float) -> np.ndarray:
    return np.arange(round(length * RATE)) / RATE


def trace(time: np.ndarray, start: float, stretch: float = 1.0, sweep: Excitation = SWEEP) -> np.ndarray:
    return POSITION + way(sweep, (time - start) / stretch)


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(start=st.floats(0.0, 6.0), backward=st.booleans(), places=st.sampled_from([4, 5, 6]), seed=st.integers(0, 99))
def test_the_start_is_found_to_a_part_of_a_sample(start: float, backward: bool, places: int, seed: int) -> None:
    sweep = replace(SWEEP, offset_velocity=-SWEEP.offset_velocity) if backward else SWEEP
    time = clock(12.0)
    degrees = np.degrees(trace(time, start, sweep=sweep))
    noise = 2e-5 * np.random.default_rng(seed).standard_normal(len(time))
    found = motion_start(sweep, POSITION, time, np.radians(np.round(degrees + noise, places)), "trace")
    assert abs(found - start) < 0.02 / RATE


def test_neither_a_move_before_nor_a_lost_end_disturbs() -> None:
    time = clock(14.0)
    before = 0.4 * np.clip(1 - time / 3.0, 0.0, 1.0)  # positioning, at rest after 3 s
    assert abs(motion_start(SWEEP, POSITION, time, trace(time, 7.003) + before, "t") - 7.003) < 1e-4
    short = clock(7.003 + SWEEP.duration - 0.45)  # ends in the last ramp
    assert abs(motion_start(SWEEP, POSITION, short, trace(short, 7.003), "t") - 7.003) < 1e-4
    late = clock(6.0)  # triggered in the first ramp
    assert abs(motion_start(SWEEP, POSITION, late, trace(late, -0.3), "t") + 0.3) < 1e-4


OTHERS: dict[str, tuple[np.ndarray, str]] = {
    "other sweep": (trace(clock(12), 2.0, sweep=OTHER), "is not this sweep's path"),
    "still": (np.full(3000, POSITION), "moves by 0 rad"),
    "80 %": (trace(clock(12), 2.0, stretch=1.25), r"took 125\.00 % of its time: feed override"),
    "50 %": (trace(clock(12), 2.0, stretch=2.0), r"took 200\.00 % of its time"),
    "twice": (trace(clock(12), 2.0, stretch=0.5), r"took 50\.00 % of its time"),
    "a little slow": (trace(clock(12), 2.0, stretch=1.002), r"took 100\.20 % of its time"),
    "pose": (trace(clock(12), 2.0) + 0.3, r"starts \+0\.30000 rad \(m\) from the start of the path, -0\.52000"),
    "mirrored": (2 * POSITION - trace(clock(12), 2.0), "opposite direction: wrong direction"),
    "cut": (trace(clock(5.7), 2.0), "lies outside of the trace"),
    "torn": (trace(clock(4.5), 2.0), "which ends at 4.496 s"),
    "short": (trace(clock(2.0), 0.1), "is shorter than the sweep"),
    "stopped": (np.minimum(trace(clock(12), 2.0), POSITION + 0.02), "is not this sweep's path"),
}


@pytest.mark.parametrize(("signal", "reason"), OTHERS.values(), ids=OTHERS)
def test_what_does_not_match_is_refused_with_its_reason(signal: np.ndarray, reason: str) -> None:
    with pytest.raises(BadInput, match=reason):
        motion_start(SWEEP, POSITION, np.arange(len(signal)) / RATE, signal, "trace.csv")


LONG = np.arange(2**21, dtype=np.float64) * 0.02


@pytest.mark.parametrize(
    ("changes", "position", "time", "reason"),
    [
        ({}, 1e308, clock(12.0), r"pose reaches 1e\+308 rad \(m\), limit 1e\+06"),
        ({"offset_velocity": 1e308}, 0.0, clock(12.0), "path reaches .*, limit"),
        ({"ramp": 1e16}, 0.0, clock(12.0), "is shorter than the sweep of"),
        ({"settle": float("inf")}, 0.0, clock(12.0), "is shorter than the sweep of"),
        ({"period": 1e300, "periods": 10**9}, 0.0, clock(12.0), "is shorter than the sweep of"),
        ({}, POSITION, LONG, r"trace of 41943 s is too long for the search, limit 20972 s"),
    ],
)
def test_what_is_beyond_all_measure_is_refused_before_it_is_searched(
    changes: dict[str, Any], position: float, time: np.ndarray, reason: str
) -> None:
    with pytest.raises(BadInput, match=reason):
        motion_start(replace(SWEEP, **changes), position, time, trace(time, 2.0), "trace.csv")


def test_a_long_trace_takes_no_more_memory_than_some_copies_of_it() -> None:
    """A path of 2 minutes in a trace of 10 took 1.4 GB as a table of all differences."""
    sweep = replace(SWEEP, periods=120)
    time = clock(600.0)
    signal = trace(time, 333.3, sweep=sweep)
    tracemalloc.start()
    assert abs(motion_start(sweep, POSITION, time, signal, "t") - 333.3) < 1e-4
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 100e6


@pytest.mark.parametrize("factor", [-1.0, 0.5, 60.0])
def test_a_channel_of_something_else_is_refused(factor: float) -> None:
    expected = way(SWEEP, clock(5.0))
    check_follows("position", 1.05 * expected + 3.0, expected, "trace.csv")
    with pytest.raises(BadInput, match=f"velocity moves {factor:.3g} times as far"):
        check_follows("velocity", factor * expected, expected, "trace.csv")
