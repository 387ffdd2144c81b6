"""Motor side in rev, rev/min, N m <-> joint side in SI.

With u the signed gear ratio, theta the motor angle [rad] and q0 the joint position at encoder zero:
q = theta / u + q0,  qd = theta' / u,  effort = u * motor torque.
"""

import math
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Value = TypeVar("Value", float, NDArray[np.float64])


@dataclass(frozen=True, slots=True)
class Gear:
    """Conversions of one axis."""

    ratio: float
    position_offset: float  # rad (m)
    rated_torque: float  # N m of the motor

    def position(self, revolutions: Value) -> Value:
        """Motor rev -> rad (m)."""
        return revolutions * (math.tau / self.ratio) + self.position_offset

    def velocity(self, rev_per_min: Value) -> Value:
        """Motor rev/min -> rad/s (m/s)."""
        return rev_per_min * (math.tau / 60 / self.ratio)

    def effort(self, torque: Value) -> Value:
        """Motor N m -> N m (N)."""
        return torque * self.ratio

    def effort_of_permille(self, permille: float) -> float:
        """Per mille of the rated torque -> N m (N)."""
        return self.effort(permille * 1e-3 * self.rated_torque)

    def revolutions(self, position: float) -> float:
        """rad (m) -> motor rev."""
        return (position - self.position_offset) * (self.ratio / math.tau)

    def rev_per_min(self, velocity: float) -> float:
        """rad/s (m/s) -> motor rev/min, signed."""
        return velocity * (self.ratio * 60 / math.tau)

    def speed(self, speed: float) -> float:
        """As `rev_per_min` for a magnitude; also rad/s^2 (m/s^2) -> rev/min/s."""
        return abs(self.rev_per_min(speed))

    def permille(self, effort: float) -> float:
        """Magnitude of an effort, N m (N) -> per mille of the rated torque."""
        return effort / (self.rated_torque * abs(self.ratio)) * 1e3

    def window(self, window: tuple[float, float]) -> tuple[float, float]:
        """Joint limits -> motor rev, low before high whatever the gear's sign."""
        low, high = sorted(self.revolutions(limit) for limit in window)
        return low, high
