"""Finds the start of a sweep in the trace of a CNC: compares the set position with the path of the sweep.

The trace starts at any trigger. Coarse search: the whole path is shifted along the record; the smallest variance of the
difference is best. Fine search: least squares of (start, stretch of time, offset of position) over the motion, so that
the start is known to a small fraction of a sample. A trace that does not match is rejected, with the probable cause:

- the residual exceeds `RESIDUAL` of the sines' RMS amplitude: another sweep, another axis;
- time is stretched by more than 5e-4 (the lines would be at other frequencies): feed override, cycle;
- the path starts elsewhere by more than `START`: another pose, another zero.
"""

from dataclasses import dataclass
from typing import cast

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import fftconvolve

from service import BadInput
from service.identification.design.excitation import Excitation, way
from service.model import Array

RESIDUAL = 0.05  # of the sines' RMS amplitude
START = 2e-3  # rad (m)

_COARSE = 0.02  # s, a tenth of a period at 5 Hz


@dataclass(frozen=True, slots=True)
class _Match:
    start: float  # s into the trace
    stretch: float
    offset: float  # rad (m)
    rms: float  # of the residual, rad (m)


def motion_start(path: Excitation, position: float, time: Array, set_position: Array, place: str) -> float:
    """Start time, s, of the motion from `position`, rad (m), in a trace of `set_position` (n,) at `time` (n,), s.

    BadInput at `place` if the trace does not contain this motion at its true speed, or not the whole measured window.
    """
    measured = path.measure_from + path.periods * path.period
    if not path.periods * path.period <= time[-1] - time[0] or not path.duration <= 2 * (time[-1] - time[0]):
        raise BadInput(
            place, f"a trace of {time[-1] - time[0]:.3f} s is shorter than the sweep of {path.duration:.3f} s"
        )
    _check_size(path, position, time, set_position, place)
    swing = float(np.sqrt(sum((sine.amplitude / (2 * np.pi * sine.frequency)) ** 2 for sine in path.sines) / 2))
    if np.ptp(set_position) < swing:
        raise BadInput(
            place,
            f"the set position moves by {np.ptp(set_position):.2g} rad (m), limit at least {swing:.2g}: it is probably "
            "of another axis",
        )
    match = _match(path, position, time, set_position, np.ones(1))
    if not match.rms <= RESIDUAL * swing:
        raise BadInput(place, _what_it_is(path, position, time, set_position, match, swing))
    if not abs(match.stretch - 1) <= 5e-4:
        raise BadInput(place, _slow(match))
    if abs(match.offset) > START:
        raise BadInput(
            place,
            f"the set position starts {match.offset:+.5f} rad (m) from the start of the path, {position:.5f}; "
            f"limit {START}: another pose, or another zero of the axis",
        )
    if match.start + path.measure_from < time[0] or match.start + measured > time[-1]:
        raise BadInput(
            place,
            f"the measured window, {match.start + path.measure_from:.3f} to {match.start + measured:.3f} s, lies "
            f"outside of the trace, which ends at {time[-1]:.3f} s",
        )
    return match.start


def _check_size(path: Excitation, position: float, time: Array, set_position: Array, place: str) -> None:
    """BadInput if the search would need numbers that overflow, or more points than its limit."""
    largest = 1e6  # rad (m): above any axis; its square does not overflow
    most = 2**20  # points of the coarse search: a trace of almost six hours
    with np.errstate(over="ignore", invalid="ignore"):
        ways = np.abs(way(path, np.linspace(0.0, path.duration, 1000)))
    for name, value in (("pose", abs(position)), ("path", ways.max()), ("set position", np.abs(set_position).max())):
        if not value <= largest:
            raise BadInput(place, f"{name} reaches {value:.3g} rad (m), limit {largest:g}")
    points = (len(time) - 1) / _stride(time)
    if points > most:
        raise BadInput(place, f"trace of {time[-1] - time[0]:.0f} s is too long for the search, limit "
                       f"{most * _COARSE:.0f} s: cut it to one sweep")  # fmt: skip


def check_follows(name: str, channel: Array, expected: Array, place: str) -> None:
    """BadInput unless the channel follows the expected signal: slope 1 within 20 %, by least squares."""
    deviation = expected - expected.mean()
    slope = float(deviation @ channel) / float(deviation @ deviation)
    # following error of the position control is smaller; errors of gear ratio or unit are larger
    if not abs(slope - 1) <= 0.2:
        raise BadInput(
            place,
            f"{name} moves {slope:.3g} times as far as the path: another axis, or a wrong unit, sign or gear ratio",
        )


def _what_it_is(path: Excitation, position: float, time: Array, signal: Array, match: _Match, swing: float) -> str:
    """The most likely reason why the trace is not this motion."""
    # 2 % apart
    slow = _match(path, position, time, signal, np.geomspace(0.2, 5.0, 163))
    if slow.rms <= RESIDUAL * swing:
        return _slow(slow)
    mirrored = _match(path, position, time, 2 * position - signal, np.ones(1))
    if mirrored.rms <= RESIDUAL * swing:
        return "the set position follows the path in the opposite direction: wrong direction of the axis"
    return (
        f"the set position is not this sweep's path: {match.rms:.3g} rad (m) RMS away from it, limit "
        f"{RESIDUAL * swing:.3g}; another sweep, another axis, or not the whole motion"
    )


def _slow(match: _Match) -> str:
    return (
        f"the path took {100 * match.stretch:.2f} % of its time: feed override not 100 %, "
        "or another cycle of the program or the trace"
    )


def _match(path: Excitation, position: float, time: Array, signal: Array, stretches: Array) -> _Match:
    """The best fit, started from the best of these stretches."""
    start, stretch = _search(path, time, signal, stretches)
    rest = 0.5  # s before and after the motion
    first, last = start - rest, start + stretch * path.duration + rest
    part = (time >= first) & (time <= last)
    times, values = time[part], signal[part] - position

    def difference(guess: Array) -> Array:
        return values - guess[2] - way(path, (times - guess[0]) / guess[1])

    reach = 0.2 * stretch  # s; less than half the path, so that the motion cannot leave the record
    fit = least_squares(
        difference,
        np.array([start, stretch, 0.0]),
        bounds=([start - reach, stretch / 1.1, -np.inf], [start + reach, stretch * 1.1, np.inf]),
        x_scale=np.array([_COARSE, 0.01, START]),
    )
    found, left = cast(Array, fit.x), cast(Array, fit.fun)
    return _Match(float(found[0]), float(found[1]), float(found[2]), float(np.sqrt(np.mean(left**2))))


def _search(path: Excitation, time: Array, signal: Array, stretches: Array) -> tuple[float, float]:
    """Start, s, and stretch of least variance; up to half of the path may be outside the trace."""
    stride = _stride(time)
    step = float(time[stride] - time[0])
    least, start, found = np.inf, 0.0, float(stretches[0])
    for stretch in stretches:
        template = way(path, np.arange(0.0, path.duration * stretch, step) / stretch)
        lead = len(template) // 2
        padded = np.pad(signal[::stride], lead, constant_values=np.nan)
        if len(padded) < len(template):
            continue
        variance = _variances(padded, template)
        best = int(np.argmin(variance))
        if variance[best] < least:
            least, start, found = float(variance[best]), float(time[0]) + (best - lead) * step, float(stretch)
    return start, found


def _stride(time: Array) -> int:
    """Samples between the points of the coarse search."""
    return max(1, round(_COARSE * (len(time) - 1) / (time[-1] - time[0])))


def _variances(signal: Array, template: Array) -> Array:
    """(n - m + 1,) variance of signal (n,) minus template (m,) at each shift; NaN in the signal is ignored.

    Uses sums and one FFT correlation for all shifts; the differences themselves would need n m numbers.
    """
    length = len(template)
    there = ~np.isnan(signal)
    values = np.where(there, signal - np.nanmean(signal), 0.0)
    shape = template - template.mean()
    weights = there.astype(float)

    def sums(of: Array) -> Array:
        total = np.concatenate([[0.0], np.cumsum(of)])
        return total[length:] - total[:-length]

    def correlation(of: Array, by: Array) -> Array:
        return np.asarray(fftconvolve(of, by[::-1], mode="valid"), dtype=float)

    count = sums(weights)
    mean = (sums(values) - correlation(weights, shape)) / count
    square = (sums(values**2) - 2 * correlation(values, shape) + correlation(weights, shape**2)) / count
    return square - mean**2
