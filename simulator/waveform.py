"""The velocity set-point of a sweep, as the measuring function generates it (docs/reference/virtual-drive.md), and
motion with piecewise constant acceleration: positioning by a trapezoid, and the ramp to standstill.

From speed v to speed w with acceleration a the distance is (w^2 - v^2) / 2a. A trapezoid over the distance D from
speed v0 >= 0 in the direction of D reaches at most vp^2 = (2 a d D + d v0^2) / (a + d) with acceleration a,
deceleration d.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Waveform:
    """``e(t) (offset + sum a sin(2 pi f (t - t0) + phase))``, t0 = ramp + settle; e: raised cosine up, one, down."""

    offset_velocity: float  # rad/s, signed
    sines: tuple[tuple[float, float, float], ...]  # (frequency Hz, amplitude rad/s, phase rad)
    period: float  # s
    periods: int
    ramp: float  # s
    settle: float  # s

    @property
    def measure_from(self) -> float:
        """t0, s: start of the window of whole periods."""
        return self.ramp + self.settle

    @property
    def duration(self) -> float:
        """From standstill to standstill, s."""
        return 2 * self.ramp + self.settle + self.period * self.periods

    def velocity(self, time: Array) -> Array:
        """Set-point at any times (n,), s since the start: (n,) rad/s; zero outside the sweep."""
        wave = np.full_like(time, self.offset_velocity)
        for frequency, amplitude, phase in self.sines:
            wave += amplitude * np.sin(2 * np.pi * frequency * (time - self.measure_from) + phase)
        return wave * self.envelope(time)

    def envelope(self, time: Array) -> Array:
        """e(t) at any times (n,), s since the start; zero outside."""
        to_edge = np.minimum(time, self.duration - time)
        if self.ramp == 0:
            return (to_edge >= 0).astype(float)
        return (1 - np.cos(np.pi * np.clip(to_edge / self.ramp, 0.0, 1.0))) / 2


def lines(lowest: float, highest: float, period: float) -> range:
    """The k whose frequency k / period, Hz, lies in the band (ends included) and is not zero."""
    return range(max(1, math.ceil(lowest * period - 1e-9)), math.floor(highest * period + 1e-9) + 1)


def torque_noise(rms: float, lowest: float, highest: float, period: float, seed: int, cycle: float) -> Array:
    """One period at the cycles 1, 2, ... (n,), in the unit of `rms`; n = period / cycle, to be repeated.

    Phases are from NumPy's PCG64 by `seed`, line by line. Raises ValueError if the period is not a whole number of
    cycles, no line is in the band, or a line is not below half the cycle rate.
    """
    count, band = round(period / cycle), lines(lowest, highest, period)
    if not math.isclose(count * cycle, period, rel_tol=1e-9):
        raise ValueError(f"period {period} s is not a multiple of {cycle} s")
    if not band or not 2 * band[-1] < count:
        raise ValueError(f"band {lowest} to {highest} Hz: no line, or one above the rate, with a period of {period} s")
    spectrum = np.zeros(count // 2 + 1, dtype=complex)
    phases = np.random.default_rng(seed).uniform(0.0, 2 * np.pi, len(band))
    spectrum[band.start : band.stop] = rms * math.sqrt(2 / len(band)) * np.exp(1j * (phases - np.pi / 2))
    return np.roll(np.fft.irfft(spectrum, count, norm="forward") / 2, -1)


@dataclass(frozen=True, slots=True)
class RampProfile:
    """Speeds `velocities` (k + 1,) at the ends of k phases of `durations` (k,), linear between them; the last one is
    kept.
    """

    durations: tuple[float, ...]
    velocities: tuple[float, ...]

    @property
    def duration(self) -> float:
        return sum(self.durations)

    @property
    def distance(self) -> float:
        return float(self.position(np.array([self.duration]))[0])

    def position(self, time: Array) -> Array:
        """Distance since the start at each time >= 0; shapes (m,) -> (m,)."""
        corners = np.concatenate(([0.0], np.cumsum(self.durations)))
        speeds = np.array(self.velocities)
        ways = np.concatenate(([0.0], np.cumsum(np.diff(corners) * (speeds[:-1] + speeds[1:]) / 2)))
        phase = np.clip(np.searchsorted(corners, time, side="right") - 1, 0, len(speeds) - 1)
        since = time - corners[phase]
        return ways[phase] + since * (speeds[phase] + self.velocity(time)) / 2

    def velocity(self, time: Array) -> Array:
        """The speed at each time >= 0; shapes (m,) -> (m,)."""
        return np.interp(time, np.concatenate(([0.0], np.cumsum(self.durations))), np.array(self.velocities))


def brake(velocity: float, deceleration: float) -> RampProfile:
    """From `velocity` to standstill at `deceleration` > 0."""
    if velocity == 0.0:
        return RampProfile((), (0.0,))
    return RampProfile((abs(velocity) / deceleration,), (velocity, 0.0))


def travel(distance: float, start: float, limit: float, acceleration: float, deceleration: float) -> RampProfile:
    """From speed `start` over `distance` (both signed) to standstill, at most at `limit` > 0.

    If the present speed leads away from the target or past it, the axis first brakes to standstill and returns.
    """
    direction = math.copysign(1.0, distance)
    way, speed = abs(distance), start * direction
    stopping = speed * abs(speed) / (2 * deceleration)
    if speed < 0 or stopping > way:
        first = brake(start, deceleration)
        return _joined(first, travel(distance - first.distance, 0.0, limit, acceleration, deceleration))
    if speed > limit:
        slow = RampProfile(((speed - limit) / deceleration,), (start, limit * direction))
        return _joined(slow, travel(distance - slow.distance, limit * direction, limit, acceleration, deceleration))
    peak = math.sqrt((2 * acceleration * deceleration * way + deceleration * speed**2) / (acceleration + deceleration))
    peak = max(min(peak, limit), speed)
    if peak == 0.0:  # zero distance, or so small that its square is zero
        return RampProfile((), (0.0,))
    cruise = way - (peak**2 - speed**2) / (2 * acceleration) - peak**2 / (2 * deceleration)
    durations = ((peak - speed) / acceleration, max(cruise, 0.0) / peak, peak / deceleration)
    return RampProfile(durations, (start, peak * direction, peak * direction, 0.0))


def _joined(first: RampProfile, second: RampProfile) -> RampProfile:
    return RampProfile(first.durations + second.durations, first.velocities + second.velocities[1:])
