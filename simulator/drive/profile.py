"""Motion with piecewise constant acceleration: positioning by a trapezoid, and the ramp to standstill.

From speed v to speed w with acceleration a the distance is (w^2 - v^2) / 2a. A trapezoid over the distance D from
speed v0 >= 0 in the direction of D reaches at most vp^2 = (2 a d D + d v0^2) / (a + d) with acceleration a,
deceleration d.
"""

import math
from dataclasses import dataclass

import numpy as np

from simulator.waveform import Array


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
        """Total distance."""
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
