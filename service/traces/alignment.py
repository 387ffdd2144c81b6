"""Where in a CNC's trace a sweep begins: its set position laid over the sweep's path.

The trace runs from some trigger on. Coarse: the whole path is slid along the record, the least variance of the
difference wins. Fine: least squares of (start, stretch of time, offset of position) over the motion, so that the start
is known to a small part of a sample. What does not match is refused, with what it looks like:

- the difference left over exceeds `RESIDUAL` of the sines' RMS way: another sweep, another axis;
- time is stretched by more than `STRETCH` (the lines would lie beside their frequencies): feed override, cycle;
- the path starts elsewhere by more than `START`: another pose, another zero.
"""

from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from service.errors import BadInput
from service.identification.design.excitation import Excitation
from service.identification.design.sweep_path import way

Array = NDArray[np.float64]

RESIDUAL = 0.05  # of the sines' RMS way
STRETCH = 5e-4
START = 2e-3  # rad (m)
FOLLOWS = 0.2  # a drive follows late by its position control; gear ratios and units are wrong by more

_COARSE = 0.02  # s, a tenth of a period at 5 Hz
_STRETCHES = np.geomspace(0.2, 5.0, 163)  # 2 % apart, tried only to tell what is wrong
_REACH = 0.2  # s that the coarse start may be off
_STANDSTILL = 0.5  # s before and after the motion that take part in the fit


@dataclass(frozen=True, slots=True)
class _Match:
    start: float  # s into the trace
    stretch: float
    offset: float  # rad (m)
    rms: float  # of what is left over, rad (m)


def motion_start(path: Excitation, position: float, time: Array, set_position: Array, place: str) -> float:
    """When the motion starts from `position`, rad (m), in a trace of `set_position` (n,) at `time` (n,); s.

    BadInput at `place` where the trace does not show this motion at its true speed, or not all of the measured window.
    """
    measured = path.measure_from + path.periods * path.period
    if time[-1] - time[0] < path.periods * path.period:
        raise BadInput(place, f"trace of {time[-1] - time[0]:.3f} s cannot hold a sweep of {path.duration:.3f} s")
    swing = float(np.sqrt(sum((sine.amplitude / (2 * np.pi * sine.frequency)) ** 2 for sine in path.sines) / 2))
    if np.ptp(set_position) < swing:
        raise BadInput(place, f"the set position moves by {np.ptp(set_position):.2g} rad (m) only: another axis?")
    match = _match(path, position, time, set_position, np.ones(1))
    if not match.rms <= RESIDUAL * swing:
        raise BadInput(place, _what_it_is(path, position, time, set_position, match, swing))
    if not abs(match.stretch - 1) <= STRETCH:
        raise BadInput(place, _slow(match))
    if abs(match.offset) > START:
        raise BadInput(
            place,
            f"the set position starts {match.offset:+.5f} off the path's {position:.5f} rad (m), limit {START}: "
            "another pose, or another zero of the axis",
        )
    if match.start + path.measure_from < time[0] or match.start + measured > time[-1]:
        raise BadInput(
            place,
            f"the measured window, {match.start + path.measure_from:.3f} to {match.start + measured:.3f} s, lies "
            f"outside of the trace, which ends at {time[-1]:.3f} s",
        )
    return match.start


def check_follows(name: str, channel: Array, expected: Array, place: str) -> None:
    """BadInput unless the channel moves with what is expected of it: slope 1 within `FOLLOWS`, by least squares."""
    deviation = expected - expected.mean()
    slope = float(deviation @ channel) / float(deviation @ deviation)
    if not abs(slope - 1) <= FOLLOWS:
        raise BadInput(
            place,
            f"{name} moves {slope:.3g} times as far as the path: another axis, or a wrong unit, sign or gear ratio",
        )


def _what_it_is(path: Excitation, position: float, time: Array, signal: Array, match: _Match, swing: float) -> str:
    """The likeliest reason for a trace that is not this motion."""
    slow = _match(path, position, time, signal, _STRETCHES)
    if slow.rms <= RESIDUAL * swing:
        return _slow(slow)
    mirrored = _match(path, position, time, 2 * position - signal, np.ones(1))
    if mirrored.rms <= RESIDUAL * swing:
        return "the set position runs the path backwards: wrong direction of the axis"
    return (
        f"the set position is not this sweep's path: {match.rms:.3g} rad (m) RMS off at best, limit "
        f"{RESIDUAL * swing:.3g}; another sweep, another axis, or not the whole motion"
    )


def _slow(match: _Match) -> str:
    return (
        f"the path took {100 * match.stretch:.2f} % of its time: feed override not 100 %, "
        "or another cycle of the program or the trace"
    )


def _match(path: Excitation, position: float, time: Array, signal: Array, stretches: Array) -> _Match:
    """The best fit, begun at the best of these stretches."""
    start, stretch = _search(path, time, signal, stretches)
    first, last = start - _STANDSTILL, start + stretch * path.duration + _STANDSTILL
    part = (time >= first) & (time <= last)
    times, values = time[part], signal[part] - position

    def difference(guess: Array) -> Array:
        return values - guess[2] - way(path, (times - guess[0]) / guess[1])

    reach = _REACH * stretch  # short of half the path, which would let the motion slip out of the record
    fit = least_squares(
        difference,
        np.array([start, stretch, 0.0]),
        bounds=([start - reach, stretch / 1.1, -np.inf], [start + reach, stretch * 1.1, np.inf]),
        x_scale=np.array([_COARSE, 0.01, START]),
    )
    found, rest = cast(Array, fit.x), cast(Array, fit.fun)
    return _Match(float(found[0]), float(found[1]), float(found[2]), float(np.sqrt(np.mean(rest**2))))


def _search(path: Excitation, time: Array, signal: Array, stretches: Array) -> tuple[float, float]:
    """Start, s, and stretch of least variance; up to half of the path may lie beyond the trace's ends."""
    stride = max(1, round(_COARSE * (len(time) - 1) / (time[-1] - time[0])))
    step = float(time[stride] - time[0])
    least, start, found = np.inf, 0.0, float(stretches[0])
    for stretch in stretches:
        template = way(path, np.arange(0.0, path.duration * stretch, step) / stretch)
        lead = len(template) // 2
        padded = np.pad(signal[::stride], lead, constant_values=np.nan)
        if len(padded) < len(template):
            continue
        windows = np.lib.stride_tricks.sliding_window_view(padded, len(template))
        variance = np.nanvar(windows - template, axis=1)
        best = int(np.argmin(variance))
        if variance[best] < least:
            least, start, found = float(variance[best]), float(time[0]) + (best - lead) * step, float(stretch)
    return start, found
