"""The closed-form path of a sweep against its velocity set-point, for any sweep."""

from itertools import pairwise

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from service.identification.design.excitation import Excitation, peak_jerk, velocity_setpoint, way
from service.model.recording import Sine


def numbers(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_nan=False)


SINES = st.builds(Sine, frequency=numbers(0.2, 10.0), amplitude=numbers(0.0, 0.1), phase=numbers(-7.0, 7.0))
SWEEPS = st.builds(
    Excitation,
    offset_velocity=numbers(-0.1, 0.1),
    sines=st.lists(SINES, max_size=5).map(tuple),
    period=numbers(0.1, 2.0),
    periods=st.integers(1, 5),
    ramp=numbers(0.05, 2.0),
    settle=numbers(0.0, 2.0),
)
# a sine with half a turn in the ramp makes a frequency difference of zero
RESONANT = Excitation(0.02, (Sine(frequency=1.0, amplitude=0.01, phase=0.4),), 1.0, 3, 0.5, 0.5)
NODES, WEIGHTS = np.polynomial.legendre.leggauss(24)


def integrated(sweep: Excitation, end: float) -> float:
    """The set-point's integral from 0 to `end` by Gauss-Legendre on short pieces of its three smooth parts."""
    hold = sweep.duration - sweep.ramp
    total = 0.0
    for first, last in ((0.0, sweep.ramp), (sweep.ramp, hold), (hold, sweep.duration)):
        edges = np.linspace(first, max(first, min(last, end)), 40)
        for low, high in pairwise(edges):
            nodes = low + (high - low) * (NODES + 1) / 2
            total += (high - low) / 2 * float(WEIGHTS @ velocity_setpoint(sweep, nodes))
    return total


@settings(deadline=None)
@given(SWEEPS, numbers(0.0, 1.0))
@example(RESONANT, 0.03)
@example(RESONANT, 1.0)
def test_the_path_integrates_the_velocity(sweep: Excitation, part: float) -> None:
    end = part * sweep.duration
    assert abs(way(sweep, np.array([end]))[0] - integrated(sweep, end)) < 1e-12


@settings(deadline=None)
@given(SWEEPS)
@example(RESONANT)
def test_it_starts_and_ends_at_rest(sweep: Excitation) -> None:
    ends = np.array([0.0, sweep.duration])
    assert way(sweep, ends)[0] == 0.0
    np.testing.assert_allclose(velocity_setpoint(sweep, ends), 0.0, atol=1e-14)
    outside = way(sweep, np.array([-1.0, sweep.duration, sweep.duration + 1.0]))
    assert outside[0] == 0.0
    assert abs(outside[1] - outside[2]) < 1e-15  # the clock's last digit


@settings(deadline=None)
@given(SWEEPS, st.sampled_from([0.001, 0.004, 0.01]))
def test_it_is_continuous_and_its_steps_are_the_speed(sweep: Excitation, step: float) -> None:
    time = np.arange(0.0, sweep.duration + step, step)
    path = way(sweep, time)
    peak = abs(sweep.offset_velocity) + sum(sine.amplitude for sine in sweep.sines)
    assert np.abs(np.diff(path)).max() <= peak * step * (1 + 1e-9) + 1e-15
    middle = velocity_setpoint(sweep, time[:-1] + step / 2)
    # where ramp and hold meet, the second derivative jumps within its bound
    assert np.abs(np.diff(path) / step - middle).max() <= peak_jerk(sweep) * step**2 / 24 + 1e-12


def test_whole_turns_cancel() -> None:
    sines = tuple(Sine(frequency=f, amplitude=0.003, phase=f) for f in (2.0, 3.0, 4.0, 5.0))
    sweep = Excitation(0.0162, sines, 1.0, 5, 0.5, 0.5)
    assert abs(way(sweep, np.array([sweep.duration]))[0] - sweep.travel) < 1e-15
